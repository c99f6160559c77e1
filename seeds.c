/* Seeds of chains from independent samples.
 *
 * A sample of the path tracer or the bidirectional one that is worth more than its threshold keeps that much, and what is left is, over its density, a sample
 * of f*: as good a seed as any of a bootstrap. Paths that cannot be joined anywhere, L S+ D S+ E, are found by a walk that meets the lamp by itself
 * and by nothing else. A bootstrap has no better way than the path tracer has, and a small part of its samples: it finds none, or one that scales a whole round.
 * So the chains' seeds of such paths are those that the independent samples of the round have met; and all others too, where these are
 * bidirectional and no bootstrap was asked for; and those that walks from the light have, bent to the lens, of which there are a fixed share beside the
 * samples: both by the balance heuristic. Each round has its own, so that the spread between rounds still tells the error.
 */
#include "run.h"
#include "bend.h"
#include <math.h>

static bool wanted(const Render *r, const Candidate *c)
{
    return c->share < 1 && (c->reach == REACH_UNJOINED || (r->bidirectional && r->settings->bootstrap == 0));
}

/* Sets Render.x to the path. False if it has no share in the chains' f*. */
static bool evaluate(const Render *r, const Candidate *c)
{
    bool found = r->bidirectional ? bdpt_path(r->bdpt, &r->chain_space, c->n_light, c->n_lens, r->x)
                                  : path_trailed(&r->chain_space, r->trail, c->n_lens, r->x);
    return found && r->x->chi > 0;
}

/* Draws with replacement: each seed gives way to the new path with the chance of its weight among all so far. What is not replaced is skipped over. The path
 * is a candidate's that is being visited; if that is NULL, Render.x. */
static void keep(Render *r, const Candidate *c, double light, double weight, PathClass class, Rng *rng)
{
    Met *m = &r->met;
    if (m->sum == 0 && c && !evaluate(r, c)) return;   /* rounding at the threshold, or the film's edge: no seed to begin with */
    m->sum += weight;
    m->now += weight;
    m->found[class].now += light;
    double log_kept = log1p(-weight / m->sum);
    bool evaluated = !c;
    for (double i = floor(log(1 - rng_double(rng)) / log_kept); i < SEEDS; i += 1 + floor(log(1 - rng_double(rng)) / log_kept)) {
        if (!evaluated && !evaluate(r, c)) return;
        evaluated = true;
        path_copy(&m->seed[(int)i], r->x);
    }
}

/* Density of a path in Render.x by walks from the light, of which one pixel of so many has one, over that by the samples of the picture. */
static double caught(const Render *r)
{
    return bend_density(&r->chain_space, r->x) * r->x->value / luminance(r->x->colour) / RUN_CATCH_STRIDE;
}

void run_meet(Render *r, const Candidate *c, double scale, Rng *rng)
{
    if (!wanted(r, c)) return;
    bool unjoined = c->reach == REACH_UNJOINED;
    if (unjoined && r->catches) {
        if (!evaluate(r, c)) return;
        scale /= 1 + caught(r);
    }
    double light = scale * luminance(c->rgb) * (1 - c->share), weight = light * (double)r->film[c->pixel].weight;
    if (isfinite(weight) && weight > 0) keep(r, c, light, weight, unjoined ? CLASS_CAUSTIC_SEEN : bdpt_class(r->bdpt, c), rng);
    else if (weight != 0) r->stats.bad_samples++;
}

typedef struct { Render *render; Rng *rng; } Catch;
static void meet_caught(void *context, double times)
{
    const Catch *c = context;
    Render *r = c->render;
    const Path *x = r->x;
    if (path_reach(x) != REACH_UNJOINED || !(x->chi > 0)) return;
    double light = times * x->share * x->value / (1 + caught(r)), weight = light * (double)r->film[x->pixel].weight;
    if (isfinite(weight)) keep(r, NULL, light, weight, CLASS_CAUSTIC_SEEN, c->rng);
    else r->stats.bad_samples++;
}

void run_catch(Render *r, Rng *rng)
{
    Catch c = { r, rng };
    bend_from_light(&r->chain_space, r->x, rng, meet_caught, &c);
    run_end_sample(r);
}

void run_end_sample(Render *r)
{
    Met *m = &r->met;
    if (m->now == 0) return;
    m->hits++;
    m->square += m->now * m->now;
    m->now = 0;
    for (int i = 0; i < CLASSES; i++) {
        double light = m->found[i].now;
        m->found[i].hits += light > 0;
        m->found[i].weight += light;
        m->found[i].square += light * light;
        m->found[i].now = 0;
    }
}

double run_met(const Render *r, double *variance)
{
    double n = r->met.rows * r->scene->camera.width, b = n > 0 ? r->met.sum / n : 0;
    *variance = n > 1 ? fmax(0, r->met.square / n - b * b) / (n - 1) : 0;
    return b;
}

void run_met_seed(const Render *r, double u, Path *x)
{
    int i = (int)(u * SEEDS);
    path_copy(x, &r->met.seed[i < 0 ? 0 : i < SEEDS ? i : SEEDS - 1]);
}

void run_forget_met(Render *r) { r->met = (Met){ .seed = r->met.seed }; }
