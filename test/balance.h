/* The sharpest test of mutations: starts that follow f* exactly (weighted bidirectional samples), a few steps each; then the expectation of
 * every function of the path must be what it was at the start. Functions tested: membership in classes of
 * length x specular pattern x quarter of the image. Counting along one long chain would prove nothing. */
#ifndef BALANCE_H
#define BALANCE_H
#include "mlt.h"
#include <stdlib.h>
#include <string.h>

enum { BALANCE_CLASSES = 4096 };

typedef struct {
    double worst_z;            /* largest |z| over classes */
    int classes;               /* with enough starts to be tested */
    uint64_t starts, bad;
    double worst_difference;   /* of the worst class, relative to b */
    unsigned worst_class;
    ChainCount count;
} Balance;

/* length (up to 7), reflect/refract/diffuse pattern of up to 3 vertices from the lens, quarter of the film */
static inline unsigned balance_class(const Space *space, const Path *x)
{
    unsigned length = (unsigned)(x->k < 7 ? x->k : 7), pattern = 0;
    for (int i = 1; i <= 3; i++) pattern = 4 * pattern + (x->k - i > 0 ? (unsigned)x->v[x->k - i].mode : 3);
    const Camera *camera = &space->scene->camera;
    unsigned quarter = (x->raster_x * 2 > camera->width) + 2u * (x->raster_y * 2 > camera->height);
    return (length * 64 + pattern) * 4 + quarter;
}

typedef struct { const Space *space; double *now; } BalanceRecord;
static inline void balance_record(void *context, const Path *x, double weight)
{
    BalanceRecord *r = context;
    r->now[balance_class(r->space, x)] += weight;
}

typedef struct { Candidate all[512]; int n; double sum; } BalanceCandidates;
static inline void balance_collect(void *context, const Candidate *c)
{
    BalanceCandidates *all = context;
    if (all->n < 512) all->all[all->n++] = *c;
    all->sum += c->weight;
}

/* n bidirectional samples; each is started from with probability min(1, W/threshold), and weighs max(W, threshold) then. */
static inline Balance balance_run(const Space *space, const Sampler *sampler, uint64_t n, uint64_t steps, uint64_t seed)
{
    Balance result = { 0 };
    Bdpt *bdpt = bdpt_new();
    Path *x = malloc(sizeof *x), *y = malloc(sizeof *y);
    double *sum = calloc(BALANCE_CLASSES, sizeof *sum), *square = calloc(BALANCE_CLASSES, sizeof *square), now[BALANCE_CLASSES];
    uint32_t *hits = calloc(BALANCE_CLASSES, sizeof *hits);
    BalanceCandidates *all = malloc(sizeof *all);
    memset(now, 0, sizeof now);
    BalanceRecord record = { space, now };
    double threshold = 0, b = 0;
    Bootstrap boot;
    if (bootstrap_run(&boot, space, bdpt, 20000, seed, 1)) { threshold = boot.b * 2; bootstrap_free(&boot); }
    const Camera *camera = &space->scene->camera;
    for (uint64_t i = 0; i < n; i++) {
        Rng rng = rng_new(seed, i + 1000000);
        all->n = 0;
        all->sum = 0;
        double u = rng_double(&rng), v = rng_double(&rng);
        bdpt_sample(bdpt, space, u * camera->width, v * camera->height, &rng, balance_collect, all);
        b += all->sum / (double)n;
        if (all->n == 0 || rng_double(&rng) * threshold >= all->sum) continue;
        double W = fmax(all->sum, threshold), left = rng_double(&rng) * all->sum;
        int c = 0;
        while (c < all->n - 1 && left >= all->all[c].weight) left -= all->all[c++].weight;
        if (!bdpt_path(bdpt, space, all->all[c].n_light, all->all[c].n_lens, x) || !(x->chi > 0)) { result.bad++; continue; }
        unsigned start = balance_class(space, x);
        now[start] -= (double)steps;
        chain_run(space, sampler, x, y, steps, &rng, balance_record, &record, &result.count);
        result.starts++;
        for (unsigned k = 0; k < BALANCE_CLASSES; k++)
            if (now[k] != 0) {
                double d = W * now[k] / (double)steps;
                sum[k] += d;
                square[k] += d * d;
                hits[k]++;
                now[k] = 0;
            }
    }
    for (unsigned k = 0; k < BALANCE_CLASSES; k++) {
        if (hits[k] < 400) continue;
        double z = fabs(sum[k]) / sqrt(square[k]);
        result.classes++;
        if (z > result.worst_z || isnan(z)) {
            result.worst_z = z;
            result.worst_class = k;
            result.worst_difference = sum[k] / (double)n / b;
        }
    }
    result.bad += result.count.bad;
    free(x); free(y); free(sum); free(square); free(hits); free(all);
    bdpt_free(bdpt);
    return result;
}
#endif
