/* Lamps that are seen by way of specular vertices alone, L S+ E, where the path tracer finds them too rarely: the sparkle of ripples, of facets, of
 * a ball's rim. See render.h for how the rest of the integrand is divided.
 *
 * Neither the path tracer nor the chains do them well. To the first they are few samples of great value; the bootstrap of the second finds fewer
 * still, and one that is found then scales a whole round. But the path tracer finds them often enough to begin chains: of such a sample it keeps as
 * much as the threshold allows, and the rest is handed on by a chain that starts there and walks over the film by lens perturbations. A sample of
 * density p and weight f/p, moved by a kernel that has f for its equilibrium, is still one of weight f/p in expectation; so the rest
 * is divided evenly among the chain's states, however many. [Cline, Talbot, Egbert 2005: energy redistribution]
 */
#include "run.h"
#include <stdlib.h>

enum { STEPS_PER_THRESHOLD = 8, MOST_STEPS = 16384 };

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
        r->passes.direct[s->splat[i].pixel] += v[0] + v[1] + v[2];
        for (size_t channel = 0; channel < 3; channel++) {
            size_t at = 3 * (size_t)s->splat[i].pixel + channel;
            r->passes.light[at] += v[channel];
            r->passes.light_square[at] += v[channel] * v[channel];
        }
    }
}

bool run_spread(Render *r, const Candidate *c, Rng *rng)
{
    const Sampler sampler = { .table = &seen_mutation, .rows = 1, .share = { 1 }, .tuning = r->sampler.tuning };
    Space space = r->direct_space;
    ChainCount count = { 0 };
    space.direct = DIRECT_ONLY;
    space.part = REST;
    if (!path_trailed(&space, r->trail, c->n_lens, r->x)) return true;
    uint64_t steps = (uint64_t)fmin(ceil(STEPS_PER_THRESHOLD * (1 / c->share - 1)), MOST_STEPS);
    double rest = luminance(c->rgb) * (1 - c->share) * (double)r->film[c->pixel].weight;
    Splats s = { .splat = malloc((steps + 1) * sizeof *s.splat), .scale = rest / (double)steps };
    if (!s.splat) return false;
    chain_run(&space, &sampler, r->x, r->y, steps, rng, record, &s, &count);
    r->stats.bad_samples += count.bad;
    qsort(s.splat, s.n, sizeof *s.splat, by_pixel);
    add_splats(r, &s);
    free(s.splat);
    return true;
}
