/* Lamps that are seen by way of specular vertices alone, L S+ E, where the path tracer finds them too rarely: the sparkle of ripples, of facets, of
 * a ball's rim. See render.h for how the rest of the integrand is divided.
 *
 * Neither the path tracer nor the chains do them well. To the first they are few samples of great value; the bootstrap of the second finds fewer
 * still, and one that is found then scales a whole round. But the path tracer finds them often enough to begin chains: of such a sample it keeps as
 * much as the threshold allows, and the rest is handed on by chains of lens perturbations that start there. A sample of density p and weight f/p,
 * moved by a kernel that has f for its equilibrium, is still one of weight f/p in expectation; so the rest is divided evenly among the
 * states of its chains. All chains are of one length: were they longer where they begin at bright samples, they would carry more out of these
 * than they bring back. How many there are may depend on the sample: so many that what one carries is in proportion to the picture, or none, by
 * roulette, where the rest is small. [Cline, Talbot, Egbert 2005: energy redistribution] Samples are as bright as the picture on average, so that
 * is a bounded number of steps a sample, however rare and bright they are; the fewer, the longer its path is, for a step costs a ray for each edge.
 */
#include "run.h"
#include <stdlib.h>

enum {
    EDGES = 12,                    /* in the chains' paths, together, for each time that a sample is as bright as the picture */
    LENGTH = 512,                  /* of a chain */
    MOST_CHAINS = 64               /* from one sample */
};

typedef struct { uint32_t pixel; Rgb rgb; } Splat;
typedef struct { Splat *splat; size_t n; double scale; } Splats;

static void record(void *context, const Path *path, double weight)
{
    Splats *s = context;
    s->splat[s->n++] = (Splat){ path->pixel, scale(s->scale * weight * path->share / path->chi, path->colour) };
}

static int by_pixel(const void *a, const void *b)
{
    uint32_t p = ((const Splat *)a)->pixel, q = ((const Splat *)b)->pixel;
    return (p > q) - (p < q);
}

/* What one chain brings to a pixel is one sample there, however many its steps. */
static void add_splats(Render *r, const Splats *s)
{
    for (size_t i = 0, end; i < s->n; i = end) {
        Rgb sum = s->splat[i].rgb;
        for (end = i + 1; end < s->n && s->splat[end].pixel == s->splat[i].pixel; end++) sum = add(sum, s->splat[end].rgb);
        if (!finite3(sum)) { r->stats.bad_samples++; continue; }
        const double v[3] = { sum.x, sum.y, sum.z };
        for (size_t channel = 0; channel < 3; channel++) {
            size_t at = 3 * (size_t)s->splat[i].pixel + channel;
            r->passes.light[at] += v[channel];
            r->passes.light_square[at] += v[channel] * v[channel];
        }
    }
}

bool run_spread(Render *r, const Candidate *c, double scale, Rng *rng)
{
    const Sampler sampler = { .table = &seen_mutation, .rows = 1, .share = { 1 }, .tuning = r->sampler.tuning };
    Space space = r->direct_space;
    ChainCount count = { 0 };
    space.direct = DIRECT_ONLY;
    space.part = REST;
    double picture = (double)r->film[c->pixel].threshold / r->tau, rest = scale * luminance(c->rgb) * (1 - c->share) * (double)r->film[c->pixel].weight;
    double chains = fmin(EDGES * (1 - c->share) * c->value / (picture * LENGTH * (c->n_lens - 1)), MOST_CHAINS);
    Splats s = { .scale = rest / (chains * LENGTH) };
    int n = (int)(chains + rng_double(rng));
    if (n == 0) return true;
    if (!(s.splat = malloc((size_t)n * (LENGTH + 1) * sizeof *s.splat))) return false;
    for (int i = 0; i < n; i++)
        if (path_trailed(&space, r->trail, c->n_lens, r->x)) chain_run(&space, &sampler, r->x, r->y, LENGTH, rng, record, &s, &count);
    r->stats.bad_samples += count.bad;
    qsort(s.splat, s.n, sizeof *s.splat, by_pixel);
    add_splats(r, &s);
    free(s.splat);
    return true;
}
