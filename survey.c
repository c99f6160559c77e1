/* Where to divide the integrand between path tracer and chains, from what the pilot has left. See render.c for why. */
#include "run.h"
#include <string.h>

enum {
    CUTS = 19, FIRST_CUT = -8,     /* tau that are weighed: 2^-8 .. 2^10 times the picture's own value */
    SURVEY = 4000,                 /* samples for that */
    DIRECT_MOST = 4,               /* times the picture's value: what a sample of direct light may count there */
    SEEN_MOST = 16                 /* times the picture's value: threshold of lamps seen by way of specular vertices */
};

void run_divide(Render *r)
{
    r->direct_space.direct = DIRECT_INCLUDED;
    r->direct_space.part = CAPPED;
    r->direct_space.seen = SEEN_MOST / r->tau;
    r->chain_space.part = REST;
}

/* For each tau: the share of the picture that is left to the chains, and the second moment of the path tracer's capped estimate, both relative to
 * the picture and summed over samples. The moment twice: of samples of the path tracer ('one' collects one sample), which knows how paths of
 * one sample go together, and from bidirectional samples path by path, which knows what the path tracer finds too rarely. Direct light is bounded: a
 * lamp that fills little of a pixel may be missing from the pilot's picture, and one sample of it would decide. */
typedef struct { const Pixel *film; double indirect, left[CUTS], expected_moment[CUTS], moment[CUTS], mean[CUTS], one[CUTS]; } Survey;

static void survey_candidate(void *context, const Candidate *c)
{
    Survey *s = context;
    double picture = (double)s->film[c->pixel].threshold, share = luminance(c->rgb) / picture, value = c->traced / picture;
    if (!isfinite(share)) return;
    bool direct = c->reach != REACH_INDIRECT;
    if (direct) {
        share = fmin(share, DIRECT_MOST);
        value = fmin(value, DIRECT_MOST);
    } else s->indirect += share;
    double tau = ldexp(1, FIRST_CUT);
    for (int i = 0; i < CUTS; i++, tau *= 2) {
        double kept = direct || value <= tau ? 1 : tau / value;
        s->left[i] += share * (1 - kept);
        if (isfinite(kept * value)) s->expected_moment[i] += share * kept * kept * value;
    }
}

static void survey_traced(void *context, const Candidate *c)
{
    Survey *s = context;
    double picture = (double)s->film[c->pixel].threshold, share = luminance(c->rgb) / picture, value = c->traced / picture;
    if (!isfinite(share) || !(share > 0)) return;
    bool direct = c->reach != REACH_INDIRECT;
    if (direct) share = fmin(share, DIRECT_MOST);
    double tau = ldexp(1, FIRST_CUT);
    for (int i = 0; i < CUTS; i++, tau *= 2) s->one[i] += share * (direct || value <= tau ? 1 : tau / value);
}

/* Where to divide the integrand. Error times rays of the path tracer is its second moment, bounded by tau. That of the chains was measured by the
 * pilot, and goes with the square of the share of the picture that is left to them; bidirectional samples tell that share even where the path
 * tracer itself would find nothing for long. Spent in the best proportion, both together have (sqrt(a) + sqrt(b))^2. Scales the thresholds. */
void run_survey(Render *r)
{
    const Camera *camera = &r->scene->camera;
    Survey s = { .film = r->film };
    Space all = { .scene = r->scene, .max_depth = r->settings->max_depth, .direct = DIRECT_INCLUDED };
    Rng rng = rng_new(r->settings->seed, ((uint64_t)1 << 63) - 1);
    uint64_t *rays = r->scene->rays, before;
    for (int i = 0; i < SURVEY; i++)
        bdpt_sample(r->bdpt, &all, rng_double(&rng) * camera->width, rng_double(&rng) * camera->height, &rng, survey_candidate, &s);
    before = *rays;
    for (int i = 0; i < SURVEY; i++) {
        const Numbers numbers = numbers_random(&rng);
        memset(s.one, 0, sizeof s.one);
        path_trace(&all, rng_index(&rng, camera->width), rng_index(&rng, camera->height), &numbers, &rng, r->trail, survey_traced, &s);
        for (int k = 0; k < CUTS; k++) {
            s.moment[k] += s.one[k] * s.one[k];
            s.mean[k] += s.one[k] / SURVEY;
        }
    }
    double traced_rays = (double)(*rays - before) / SURVEY, best = INFINITY, tau = 1;
    /* A short pilot rather misses what is rare: its error is taken half as large again. */
    double chain = sqrt(1.5 * r->chain_error * (double)(r->stats.chain_rays + r->stats.start_rays) / (double)r->pixels);
    for (int i = 0; i < CUTS; i++) {
        double moment = fmax(s.moment[i], s.expected_moment[i]) / SURVEY, variance = fmax(moment - s.mean[i] * s.mean[i], 0.02 * moment);
        double path = sqrt(variance * traced_rays), rest = s.left[i] > 0 ? chain * s.left[i] / s.indirect : 0;
        if (pow(path + rest, 2) < 0.98 * best) {   /* a higher cap has to promise something: so few samples know little of rare values */
            best = pow(path + rest, 2);
            tau = ldexp(1, FIRST_CUT + i);
            r->direct_share = path / rest;
        }
    }
    r->tau = tau;
    for (size_t i = 0; i < r->pixels; i++) r->film[i].threshold = (float)(tau * (double)r->film[i].threshold);
    if (!(r->direct_share < 50)) r->direct_share = 50;
}
