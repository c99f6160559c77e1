/* The sharpest test of mutations: starts that follow the target f* exactly (weighted bidirectional samples), a few steps each, and no flow
 * between classes of paths may remain. Counting along one long chain would prove nothing.
 *
 * Every row claims detailed balance, so for every set E of paths and every function g of a path
 *
 *     sum over starts x of  W(x) * sum over recorded states y of  weight(y) [x in E] [y in E] ( g(y) - g(x) )
 *
 * has expectation 0: what flows from x to y flows back, for any number of steps. E, the paths that are tested, are those whose weight
 * f* / (density of the start) stays below a cap. So no start weighs much, every sum obeys the central limit theorem, and a rare path of
 * huge weight that no start has found cannot raise a false alarm. The g are the indicators of classes, several families of them:
 * a fault in a ratio shows best in classes that tell its argument apart.
 *
 * Any number of samplers (subjects), right and faulty ones, runs from the same starts. */
#ifndef BALANCE_H
#define BALANCE_H
#include "audit.h"
#include "check.h"
#include <string.h>

enum {
    FAMILY_IMAGE = 0,                              /* length x pattern x quarter: 8 * 64 * 4 */
    FAMILY_LENGTH = FAMILY_IMAGE + 2048,           /* length (up to 15) x quarter, what is rare above pooled: 16 * 4 */
    FAMILY_MODE = FAMILY_LENGTH + 64,              /* pattern x product of mode probabilities: 64 * 4 */
    FAMILY_COSINE = FAMILY_MODE + 256,             /* length x specular vertices x cosines where directions are turned: 8 * 4 * 4 */
    FAMILY_NEAR = FAMILY_COSINE + 128,             /* specular vertices x length of the edge at the lens: 4 * 64 */
    FAMILY_FAR = FAMILY_NEAR + 256,                /* specular vertices x length of the edge at the light: 4 * 64 */
    FAMILY_FLOW = FAMILY_FAR + 256,                /* from signature to signature (which vertices are specular), less what flows back: 64 * 64 */
    FAMILY_PATTERN = FAMILY_FLOW + 4096,           /* from pattern to pattern, less what flows back: 64 * 64 */
    BALANCE_CLASSES = FAMILY_PATTERN + 4096,
    BALANCE_FAMILIES = 6,                          /* of indicators */
    BALANCE_STARTS = 64,                           /* from one sample, at most */
    BALANCE_TOUCHED = 32768,
    BALANCE_ENOUGH = 30                            /* events that a flow must be worth to be tested */
};

/* Where starts come from. */
typedef enum {
    START_BDPT,                /* bidirectional samples: any path */
    START_AIMED                /* paths L S+ D S* E alone, which those hardly ever find: from the lens to D, and from there aimed at the light */
} StartKind;

typedef struct {
    const char *name;
    Sampler sampler;
    bool faulty;               /* planted: must be caught */
    /* what balance_run finds */
    double z;                  /* largest |z| over classes; infinite if a ratio was not a number */
    unsigned worst_class;
    double difference;         /* of that class, relative to b */
    int classes;               /* that were tested */
    ChainCount count;
    double in[BALANCE_CLASSES], out[BALANCE_CLASSES], in_square[BALANCE_CLASSES], out_square[BALANCE_CLASSES];   /* sums over samples */
} Subject;

typedef struct {
    uint64_t samples, starts, bad;
    double b;                  /* integral of f* over the tested paths */
    double left_out;           /* share of f* above the cap (as far as it was met) */
    double weight_error;       /* worst relative difference between a start's weight and the same by a second route */
} Balance;

typedef struct {
    StartKind kind;
    double unit, cap;          /* a sample of weight W gives W/unit starts on average, each of weight 'unit'; paths above the cap are not tested */
    double cone;               /* START_AIMED: largest angle off the light's apparent direction */
    Vec3 aim;                  /* START_AIMED: middle of the lights */
} Starts;

static inline unsigned balance_bin(double value, double scale, int bins)
{
    double i = floor(value * scale);
    return i > 0 ? i < bins - 1 ? (unsigned)i : (unsigned)(bins - 1) : 0;
}

/* The classes of a path, one of each family. */
static inline void balance_classes(const Space *space, const Path *x, unsigned class[BALANCE_FAMILIES])
{
    unsigned length8 = (unsigned)(x->k < 7 ? x->k : 7), length16 = (unsigned)(x->k < 15 ? x->k : 15), pattern = lens_pattern(x), specular = 0;
    const Camera *camera = &space->scene->camera;
    unsigned quarter = (x->raster_x * 2 > camera->width) + 2u * (x->raster_y * 2 > camera->height);
    double q = 1, cosine = 1;
    for (int i = 1; i < x->k; i++)
        if (x->v[i].mode != MODE_NONE) { specular += specular < 3; q *= x->v[i].s.q; }
    int turned, m = caustic_suffix(x);
    for (int i = m; i >= 0 && i < x->k - 1; i++)
        if (x->v[i].mode == MODE_NONE) cosine *= fabs(dot(x->v[i].to_lens, x->v[i].point.surface.ng));
    if (m < 0 && ((m = chain_suffix(x, &turned)) >= 0 || (m = lens_suffix(x)) >= 0))
        for (int i = m + 1; i < x->k; i++)
            if (x->v[i].mode == MODE_NONE) cosine *= fabs(dot(x->v[i - 1].to_lens, x->v[i].point.surface.ng));
    double near = length(sub(x->v[x->k].point.p, x->v[x->k - 1].point.p)), far = length(sub(x->v[1].point.p, x->v[0].point.p));
    class[0] = FAMILY_IMAGE + (length8 * 64 + pattern) * 4 + quarter;
    class[1] = FAMILY_LENGTH + length16 * 4 + quarter;
    class[2] = FAMILY_MODE + pattern * 4 + (q > 0.9 ? 3u : q > 0.5 ? 2u : q > 0.05 ? 1u : 0u);
    class[3] = FAMILY_COSINE + (length8 * 4 + specular) * 4 + balance_bin(cosine, 4, 4);
    class[4] = FAMILY_NEAR + specular * 64 + balance_bin(log2(near) + 5, 8, 64);
    class[5] = FAMILY_FAR + specular * 64 + balance_bin(log2(far) + 5, 8, 64);
}

/* ---- starts ---- */

/* The direction in which the light's middle is seen from a point, through the smooth refracting surface that lies on the straight way. */
static inline Vec3 balance_aim(const Space *space, const Starts *starts, const Point *from)
{
    Vec3 straight = normalize(sub(starts->aim, from->p)), bent;
    Point crossed;
    if (!scene_trace(space->scene, from, straight, &crossed)) return straight;
    return bsdf_follow(&crossed.surface, normalize(sub(starts->aim, crossed.p)), MODE_REFRACT, &bent) ? neg(bent) : straight;
}

/* f* over the density of an aimed start; 0 if the path is none. */
static inline double balance_aimed_weight(const Space *space, const Starts *starts, const Path *x)
{
    int d = x->k - 1;
    while (d > 0 && x->v[d].mode != MODE_NONE) d--;
    if (d < 2) return 0;
    double inverse = x->v[0].s.inv_F;
    for (int i = 1; i < x->k; i++)
        if (i != d) {
            if (x->v[i].mode == MODE_NONE) return 0;
            inverse *= x->v[i].s.inv_S_light;
        }
    Vec3 w = neg(x->v[d - 1].to_lens);
    if (dot(w, balance_aim(space, starts, &x->v[d].point)) < cos(starts->cone)) return 0;
    double pdf_w = 1 / (2 * PI * (1 - cos(starts->cone)));
    return x->chi / (inverse * x->v[d].s.inv_F * pdf_w / fabs(dot(w, x->v[d].point.surface.ng)));
}

static inline bool balance_aimed_start(const Space *space, const Starts *starts, Rng *rng, Path *x)
{
    int i = x->k = MAX_EDGES;                      /* grown at the far end of the array, as in the lens subpath mutation */
    path_grow_to_light(space, x, i + 1, rng);
    while (i > MAX_EDGES - space->max_depth) {
        if (!path_grow_to_light(space, x, i, rng)) return false;
        if (!material_is_specular(x->v[--i].point.surface.material)) break;
    }
    int d = i;
    if (d == MAX_EDGES - space->max_depth || material_is_specular(x->v[d].point.surface.material)) return false;
    double c = 1 - rng_double(rng) * (1 - cos(starts->cone)), phi = 2 * PI * rng_double(rng), r = sqrt(fmax(0, 1 - c * c));
    Vec3 aim = balance_aim(space, starts, &x->v[d].point), a, b;
    frame(aim, &a, &b);
    Vec3 w = along(along(scale(c, aim), r * cos(phi), a), r * sin(phi), b);
    x->v[d].mode = x->v[d - 1].mode = MODE_NONE;
    if (!scene_trace(space->scene, &x->v[d].point, w, &x->v[d - 1].point) || !path_edge(x, d - 1)) return false;
    for (i = d - 1; i > MAX_EDGES - space->max_depth && material_is_specular(x->v[i].point.surface.material); i--)
        if (!path_grow_to_light(space, x, i, rng)) return false;
    if (i == d - 1 || !material_emits(x->v[i].point.surface.material)) return false;
    x->k = MAX_EDGES - i;
    memmove(x->v, x->v + i, (size_t)(x->k + 1) * sizeof x->v[0]);
    return path_evaluate(space, x) && x->chi > 0;
}

/* The weight of a path as a start; a path is tested if this is positive and below the cap. */
static inline double balance_weight(const Space *space, const Starts *starts, const Path *x)
{
    return starts->kind == START_AIMED ? balance_aimed_weight(space, starts, x) : start_weight(x);
}

typedef struct { double cap, sum, left_out; Candidate all[1024]; int n; } BalanceCandidates;
static inline void balance_collect(void *context, const Candidate *c)
{
    BalanceCandidates *all = context;
    if (c->weight > all->cap) { all->left_out += c->weight; return; }
    if (all->n == 1024) return;
    all->all[all->n++] = *c;
    all->sum += c->weight;
}

/* ---- the run ---- */

typedef struct {
    const Space *space;
    const Starts *starts;
    double now[BALANCE_CLASSES], total;
    unsigned touched[BALANCE_TOUCHED];
    unsigned signature, pattern;                   /* of the start */
    int n;
} BalanceRecord;

static inline void balance_add(BalanceRecord *r, unsigned class, double weight)
{
    r->now[class] += weight;
    if (r->n < BALANCE_TOUCHED) r->touched[r->n++] = class;
}

/* A bit for each inner vertex, set where it is specular, and a leading 1; 0 for paths longer than 6 edges. */
static inline unsigned balance_signature(const Path *x)
{
    unsigned bits = 1;
    if (x->k > 6) return 0;
    for (int i = 1; i < x->k; i++) bits = 2 * bits + (x->v[i].mode != MODE_NONE);
    return bits;
}

static inline void balance_flow(BalanceRecord *r, unsigned family, unsigned from, unsigned to, double weight)
{
    if (from < to) balance_add(r, family + from * 64 + to, weight);
    if (from > to) balance_add(r, family + to * 64 + from, -weight);
}

static inline void balance_record(void *context, const Path *x, double weight)
{
    BalanceRecord *r = context;
    double W = balance_weight(r->space, r->starts, x);
    if (!(W > 0) || W > r->starts->cap) return;
    unsigned class[BALANCE_FAMILIES];
    balance_classes(r->space, x, class);
    for (int i = 0; i < BALANCE_FAMILIES; i++) balance_add(r, class[i], weight);
    balance_flow(r, FAMILY_FLOW, r->signature, balance_signature(x), weight);
    balance_flow(r, FAMILY_PATTERN, r->pattern, lens_pattern(x), weight);
    r->total += weight;
}

/* |z| of in = out; negative if there is too little of both to tell. The ways in and out may be very unlike: one in thousands of steps of tiny
 * probability, the other in a few certain ones, of which none may have been seen. So the variance is what it would be were both sums as
 * large as the larger: each way's events have the mean size sum of squares / sum, or that of a whole start while fewer than ten are known. */
static inline double balance_z(double unit, double in, double in_square, double out, double out_square)
{
    double in_size = in * in > 10 * in_square ? in_square / in : unit, out_size = out * out > 10 * out_square ? out_square / out : unit;
    double flow = fmax(in, out);
    if (flow < BALANCE_ENOUGH * fmax(in_size, out_size)) return -1;
    return fabs(in - out) / sqrt(flow * (in_size + out_size));
}

/* 'samples' tries for a start; from each start 'steps' steps (at most 40) with each subject. */
static inline Balance balance_run(const Space *space, Starts starts, Subject *subject, int subjects, uint64_t samples, uint64_t steps, uint64_t seed)
{
    Balance result = { .samples = samples };
    Bdpt *bdpt = bdpt_new();
    Path *start = malloc(sizeof *start), *x = malloc(sizeof *x), *y = malloc(sizeof *y);
    BalanceCandidates *found = malloc(sizeof *found);
    BalanceRecord *record = calloc(1, sizeof *record);
    const Camera *camera = &space->scene->camera;
    double left_out = 0;
    int chosen[BALANCE_STARTS];                    /* candidates to start from */
    const Mesh *mesh = &space->scene->mesh;
    for (uint32_t i = 0; i < 3 * space->scene->n_lights; i++) {
        const float *corner = mesh->position[mesh->triangle[space->scene->light[i / 3]][i % 3]];
        starts.aim = along(starts.aim, 1.0 / (3 * space->scene->n_lights), from_float(corner));
    }
    *record = (BalanceRecord){ .space = space, .starts = &starts };
    for (uint64_t i = 0; i < samples; i++) {
        Rng rng = rng_new(seed, i + 1000000);
        double W;
        if (starts.kind == START_AIMED) {
            if (!balance_aimed_start(space, &starts, &rng, start)) continue;
            W = balance_weight(space, &starts, start);
            if (W > starts.cap) { left_out += W; continue; }
        } else {
            found->cap = starts.cap;
            found->sum = found->left_out = found->n = 0;
            double u = rng_double(&rng), v = rng_double(&rng);
            bdpt_sample(bdpt, space, u * camera->width, v * camera->height, ONE_WAY, NULL, &rng, balance_collect, found);
            left_out += found->left_out;
            W = found->sum;
        }
        result.b += W;
        int n = (int)floor(W / starts.unit + rng_double(&rng));
        if (n > BALANCE_STARTS) { result.bad++; n = BALANCE_STARTS; }
        for (int c, j = 0; j < n && starts.kind == START_BDPT; j++) {
            double left = rng_double(&rng) * W;
            for (c = 0; c < found->n - 1 && left >= found->all[c].weight; c++) left -= found->all[c].weight;
            chosen[j] = c;
        }
        result.starts += (uint64_t)n;
        for (int s = 0; s < subjects && n > 0; s++) {
            Subject *me = &subject[s];
            Rng own = rng_new(seed + 1 + (uint64_t)s, i);
            record->n = 0;
            for (int j = 0; j < n; j++) {
                if (starts.kind == START_BDPT) {
                    const Candidate *c = &found->all[chosen[j]];
                    if (!bdpt_path(bdpt, space, c->n_light, c->n_lens, start) || !(start->chi > 0)) { result.bad++; continue; }
                    check_worse(&result.weight_error, fabs(balance_weight(space, &starts, start) / c->weight - 1));
                }
                bool applies = false;
                for (int r = 0; r < me->sampler.rows; r++) applies |= me->sampler.share[r] > 0 && me->sampler.table[r].applies(space, start);
                if (!applies) continue;            /* the state would stay: nothing flows */
                path_copy(x, start);
                record->total = 0;
                record->signature = balance_signature(start);
                record->pattern = lens_pattern(start);
                chain_run(space, &me->sampler, x, y, steps, &own, balance_record, record, &me->count);
                unsigned class[BALANCE_FAMILIES];
                balance_classes(space, start, class);
                for (int f = 0; f < BALANCE_FAMILIES; f++) balance_add(record, class[f], -record->total);
            }
            for (int t = 0; t < record->n; t++) {  /* the sample is the unit of variance: its starts depend on each other */
                unsigned k = record->touched[t];
                double d = starts.unit * record->now[k] / (double)steps;
                record->now[k] = 0;
                if (fabs(d) < 1e-9 * starts.unit) continue;
                if (d > 0) { me->in[k] += d; me->in_square[k] += d * d; }
                else { me->out[k] -= d; me->out_square[k] += d * d; }
            }
        }
    }
    result.left_out = left_out / (left_out + result.b);
    result.b /= (double)samples;
    for (int s = 0; s < subjects; s++) {
        Subject *me = &subject[s];
        for (unsigned k = 0; k < BALANCE_CLASSES; k++) {
            double z = balance_z(starts.unit, me->in[k], me->in_square[k], me->out[k], me->out_square[k]);
            if (z < 0) continue;
            me->classes++;
            if (z > me->z) {
                me->z = z;
                me->worst_class = k;
                me->difference = (me->in[k] - me->out[k]) / (double)samples / result.b;
            }
        }
        if (me->count.bad > 0) me->z = INFINITY;
    }
    bdpt_free(bdpt);
    free(start); free(x); free(y); free(found); free(record);
    return result;
}
#endif
