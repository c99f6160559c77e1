/* The Metropolis sampler. See mlt.h for what is exact and why. [lecture: Large-scale structure of code; Veach ch. 11] */
#include "mlt.h"
#include <stdlib.h>

/* What one sample found: of the target, and of the light by classes, without the weight w of the two-stage target. */
typedef struct { const Bdpt *bdpt; const Pixel *film; double weight, light[CLASSES]; } Found;
static void add_found(void *context, const Candidate *c)
{
    Found *f = context;
    f->weight += c->weight;
    f->light[bdpt_class(f->bdpt, c)] += c->weight / (f->film ? (double)f->film[c->pixel].weight : 1);
}

static void sample(const Bootstrap *s, const Space *space, Bdpt *bdpt, uint64_t i, Rng *rng, void (*visit)(void *, const Candidate *), void *context)
{
    const Camera *camera = &space->scene->camera;
    Space own = *space;
    if (s->bent > space->bent) {
        own.bent = s->bent;
        own.divided = space;
    }
    *rng = rng_new(s->seed, s->stream + i);
    bdpt_sample(bdpt, &own, even(s->offset_x, i, 0) * camera->width, even(s->offset_y, i, 1) * camera->height, BOTH_WAYS, NULL, rng, visit, context);
}

bool bootstrap_new(Bootstrap *s, uint64_t n, uint64_t seed, uint64_t stream)
{
    Rng rng = rng_new(seed, ~stream);
    *s = (Bootstrap){ .n = n, .seed = seed, .stream = stream, .sum = malloc((n ? n : 1) * sizeof *s->sum) };
    if (!s->sum) return false;
    s->offset_x = rng_double(&rng);
    s->offset_y = rng_double(&rng);
    return true;
}

void bootstrap_sample(Bootstrap *s, const Space *space, Bdpt *bdpt, uint64_t more)
{
    Rng rng;
    double sum = s->done ? s->sum[s->done - 1] : 0;
    uint64_t i = s->done, end = s->n - i < more ? s->n : i + more;
    for (; i < end; i++) {
        Found found = { .bdpt = bdpt, .film = space->film };
        sample(s, space, bdpt, i, &rng, add_found, &found);
        double weight = found.weight;
        if (!isfinite(weight)) { s->bad++; weight = 0; }
        for (int c = 0; c < CLASSES && weight > 0; c++) {
            s->found[c].hits += found.light[c] > 0;
            s->found[c].weight += found.light[c];
            s->found[c].square += found.light[c] * found.light[c];
        }
        s->hits += weight > 0;
        s->sum[i] = sum += weight;
        s->square += weight * weight;
    }
    double n = (double)(s->done = end);
    s->b = n > 0 ? sum / n : 0;
    s->b_variance = n > 1 ? fmax(0, s->square / n - s->b * s->b) / (n - 1) : 0;
}

bool bootstrap_run(Bootstrap *s, const Space *space, Bdpt *bdpt, uint64_t n, uint64_t seed, uint64_t stream)
{
    if (!bootstrap_new(s, n, seed, stream)) return false;
    bootstrap_sample(s, space, bdpt, n);
    return true;
}

void bootstrap_free(Bootstrap *s)
{
    free(s->sum);
    s->sum = NULL;
}

/* Finds the candidate at which a running sum passes 'left'. */
typedef struct { double left; const Space *space; Bdpt *bdpt; Path *x; bool found; } Pick;
static void pick(void *context, const Candidate *c)
{
    Pick *p = context;
    if (p->found && p->left < 0) return;
    p->found = bdpt_path(p->bdpt, p->space, c->n_light, c->n_lens, p->x);     /* the last one stays if rounding lets the sum end just below */
    p->left -= c->weight;
}

bool bootstrap_seed(const Bootstrap *s, const Space *space, Bdpt *bdpt, double u, Path *x)
{
    if (!(s->b > 0)) return false;
    double target = u * s->sum[s->n - 1];
    uint64_t low = 0, high = s->n - 1;         /* first i with sum[i] > target */
    while (low < high) {
        uint64_t middle = low + (high - low) / 2;
        if (s->sum[middle] > target) high = middle;
        else low = middle + 1;
    }
    Rng rng;
    Pick p = { .left = target - (low > 0 ? s->sum[low - 1] : 0), .space = space, .bdpt = bdpt, .x = x };
    sample(s, space, bdpt, low, &rng, pick, &p);
    return p.found;
}

enum { SHORTEST_STEP = -3, LONGEST_STEP = 1 };    /* powers of 2 */

static void set_steps(Tuning *t, double r1, double r2, double theta1, double theta2)
{
    t->r2 = larger(r2, 2 * r1);
    t->log_r = log(r1 / t->r2);
    t->theta2 = theta2;
    t->log_theta = log(theta1 / theta2);
}

/* pi r2^2 is 5 % of the film [Veach ch. 11]. */
static double film_step(const Scene *scene) { return sqrt(0.05 * scene->camera.width * scene->camera.height / PI); }
static const double FILM_LEAST = 0.1, TURN_LEAST = 1e-4, TURN_MOST = 0.1;

Sampler sampler_for(const Scene *scene, unsigned allowed)
{
    Sampler s = { .table = mutation_table, .rows = MUTATIONS, .tuning = { .p_d2_importance = 0.5, .light_scale = 1 } };
    set_steps(&s.tuning, FILM_LEAST, film_step(scene), TURN_LEAST, TURN_MOST);
    for (int i = 0; i < MUTATIONS; i++)
        if (allowed >> i & 1 && mutation_is_useful(&mutation_table[i], scene)) s.share[i] = mutation_table[i].share;
    return s;
}

void sampler_tune(Sampler *s, const Scene *scene, const ChainCount *count)
{
    double r2 = s->tuning.r2, theta2 = s->tuning.theta2;
    for (int i = 0; i < s->rows; i++) {
        double tried = (double)(count->row[i].proposed - count->row[i].zero), accepted = (double)count->row[i].accepted / tried;
        if (tried < 200) continue;
        double factor = accepted > 0.7 ? 2 : accepted < 0.35 ? 0.5 : 1;
        if (s->table[i].step == STEP_FILM) r2 = fmin(fmax(factor * r2, ldexp(film_step(scene), SHORTEST_STEP)), ldexp(film_step(scene), LONGEST_STEP));
        if (s->table[i].step == STEP_TURN) theta2 = fmin(fmax(factor * theta2, ldexp(TURN_MOST, SHORTEST_STEP)), ldexp(TURN_MOST, LONGEST_STEP));
    }
    set_steps(&s->tuning, FILM_LEAST, r2, TURN_LEAST, theta2);
}

/* Shares of the rows that apply to x; returns their sum. */
static double choices(const Space *space, const Sampler *s, const Path *x, double share[MUTATIONS])
{
    double sum = 0;
    for (int i = 0; i < s->rows; i++) sum += share[i] = s->share[i] > 0 && s->table[i].applies(space, x) ? s->share[i] : 0;
    return sum;
}

void chain_run(const Space *space, const Sampler *s, Path *x, Path *y, uint64_t steps, Rng *rng,
               void (*record)(void *, const Path *, double), void *context, ChainCount *count)
{
    double share_x[MUTATIONS], share_y[MUTATIONS], sum_x = choices(space, s, x, share_x), weight = 0;
    Path *const given = x;
    for (uint64_t step = 0; step < steps; step++) {
        double a = 0, u = rng_double(rng) * sum_x;
        int i = 0;
        while (i < s->rows - 1 && u >= share_x[i]) u -= share_x[i++];
        if (share_x[i] > 0) {
            Move move;
            Outcome outcome = s->table[i].propose(space, &s->tuning, x, y, rng, &move);
            count->row[i].proposed++;
            if (outcome == PROPOSED) {
                /* q_i(x) stands in T(y|x), q_i(y) in T(x|y) */
                double sum_y = choices(space, s, y, share_y), ratio = move.R_yx / move.R_xy * (share_y[i] / sum_y) / (share_x[i] / sum_x);
                a = ratio < 1 ? ratio : 1;
                if (isnan(ratio) || isinf(y->chi)) { count->bad++; a = 0; }      /* from there no chain would return */
                if (!(a > 0)) outcome = ZERO_NO_WAY;
                else if (move.joined >= 0 && !scene_visible(space->scene, &y->v[move.joined].point, &y->v[move.joined + 1].point)) outcome = ZERO_BLOCKED;
                if (outcome != PROPOSED) a = 0;
                else if (rng_double(rng) < a) {
                    weight += 1 - a;
                    if (weight > 0) record(context, x, weight);
                    Path *swap = x;
                    x = y;
                    y = swap;
                    sum_x = sum_y;
                    for (int r = 0; r < s->rows; r++) share_x[r] = share_y[r];
                    weight = a;
                    count->row[i].accepted++;
                    count->rejection = 0;
                    count->row[i].outcome[PROPOSED]++;
                    continue;
                } else record(context, y, a);
            }
            count->row[i].outcome[outcome]++;
            count->row[i].zero += outcome != PROPOSED;
        }
        weight += 1 - a;
        if (++count->rejection > count->longest_rejection) count->longest_rejection = count->rejection;
    }
    if (weight > 0) record(context, x, weight);
    if (x != given) path_copy(given, x);
    count->steps += steps;
}
