/* Where to divide the integrand between independent samples and chains, from what the pilot has left. See render.c for why. */
#include "run.h"

enum {
    CUTS = 18, FIRST_CUT = -8,     /* tau that are weighed: 2^-8 .. 2^9 times the picture's own value */
    SURE_CUTS = 14,                /* .. 2^5 whatever the survey has seen above them */
    LEAST_ABOVE = 32,              /* paths that it must have seen above a higher one */
    SURVEY = 4000,                 /* samples for that, of each kind, at least */
    DIRECT_MOST = 4,               /* times the picture's value: what a sample of direct light may count there */
    SEEN_MOST = 16,                /* times the picture's value: threshold of lamps seen by way of specular vertices */
    DIRECT_RAYS = 2,               /* of a sample of direct light alone */
    UNKNOWN_ERROR = 10,            /* error times rays of the chains where a pilot has been too short for any: what is usual */
    MOST_ERROR = 32                /* of a second pilot over that of the first: rare paths may dominate it, of which it has had less than its share */
};
/* Samples of a path tracer fill their ranges evenly, and err less than their variance says. That matters where they are on their own (rays per ray of the
 * chains) and rivalled by bidirectional ones: chains' errors are foretold too low. */
static const double ALONE = 20, EVEN = 0.7;
static const double SURVEY_SHARE = 0.1;    /* of the rays of the pilot's chains, for each kind, at least */

/* What is capped is the path tracer's; or direct light is, and a bidirectional one has the rest of it. */
void run_divide(Render *r)
{
    r->direct_space.direct = r->bidirectional ? DIRECT_ONLY : DIRECT_INCLUDED;
    r->direct_space.part = CAPPED;
    r->direct_space.seen = isinf(r->tau) ? 1 : SEEN_MOST / r->tau;
    r->direct_space.bidirectional = r->chain_space.bidirectional = r->bidirectional;
    r->joined_space = r->direct_space;
    r->joined_space.direct = DIRECT_EXCLUDED;
    r->chain_space.part = REST;
}

/* What each tau would bring, summed over samples and relative to the picture: the light that is left to the chains, and mean and second moment of the
 * capped estimate, of one sample in its own pixel and of each light path elsewhere; how many paths are above tau. */
typedef struct { double left[CUTS], mean[CUTS], moment[CUTS], own[CUTS], above[CUTS]; } Capped;

/* The path tracer's moment twice: of its own samples, which know how paths of one sample go together, and from bidirectional samples path by path,
 * which know what the path tracer finds too rarely. Direct light is bounded: a lamp that fills little of a pixel may be missing from the pilot's picture, and
 * one sample of it would decide. */
typedef struct { const Pixel *film; const float *picture; double scale, indirect, expected_moment[CUTS]; Capped traced, direct, joined; } Survey;

static double tau_of(int i) { return ldexp(1, FIRST_CUT + i); }
static double kept(double value, double tau) { return value > tau ? tau / value : 1; }

static void survey_candidate(void *context, const Candidate *c)
{
    Survey *s = context;
    double picture = (double)s->picture[c->pixel], to_tau = picture / (s->scale * (double)s->film[c->pixel].threshold);
    double joined = luminance(c->rgb) / picture, traced = c->value / picture;
    if (!isfinite(joined)) return;
    bool direct = reach_is_direct(c->reach);
    double share = direct ? fmin(joined, DIRECT_MOST) : joined;
    if (direct) traced = fmin(traced, DIRECT_MOST);
    else s->indirect += joined;
    for (int i = 0; i < CUTS; i++) {
        double tau = tau_of(i), k = direct ? 1 : kept(to_tau * traced, tau);
        s->traced.left[i] += share * (1 - k);
        s->traced.above[i] += k < 1;
        if (isfinite(k * traced)) s->expected_moment[i] += share * k * k * traced;
        if (direct) continue;
        k = kept(to_tau * joined, tau);
        s->joined.left[i] += joined * (1 - k);
        s->joined.above[i] += k < 1;
        if (c->n_lens > 1) s->joined.own[i] += k * joined;
        else s->joined.moment[i] += k * joined * k * joined;
    }
}

static void survey_traced(void *context, const Candidate *c)
{
    Survey *s = context;
    double picture = (double)s->picture[c->pixel], to_tau = picture / (s->scale * (double)s->film[c->pixel].threshold);
    double share = luminance(c->rgb) / picture, value = c->value / picture;
    if (!isfinite(share) || !(share > 0)) return;
    bool direct = reach_is_direct(c->reach);
    if (direct) share = fmin(share, DIRECT_MOST);
    for (int i = 0; i < CUTS; i++) {
        s->traced.own[i] += share * (direct ? 1 : kept(to_tau * value, tau_of(i)));
        if (direct) s->direct.own[i] += share;
    }
}

static void end_sample(Capped *c)
{
    for (int i = 0; i < CUTS; i++) {
        c->moment[i] += c->own[i] * c->own[i];
        c->mean[i] += c->own[i];
        c->own[i] = 0;
    }
}

/* Of what lands in one pixel; not less than a share of the moment, for so few samples know little of rare values. */
static double variance(const Capped *c, int i, double n, double moment)
{
    double mean = c->mean[i] / n;
    return fmax(moment - mean * mean, 0.02 * moment);
}

/* The share of the time that is left which two passes of samples take, of so many seconds each: less there cannot be. */
static double least_share(const Render *r, double seconds)
{
    double left = r->settings->start + r->settings->seconds - clock_now();
    return r->settings->seconds == 0 ? 0 : left > 0 ? fmin(2 * seconds * (double)r->pixels / left, 0.9) : 0.9;
}

/* Error times rays of two kinds of work, of error times rays a^2 and b^2 each, in the best proportion of rays, but at least a share for the first. */
static double together(double a, double b, double least)
{
    return a >= least * (a + b) ? (a + b) * (a + b) : a * a / least + b * b / (1 - least);
}

/* Where to divide the integrand, and whose the easy part is. Error times rays of independent samples is their variance, of values bounded by tau, times the rays
 * of one. That of the chains goes with a power of the share of the picture that is left to them: the square, says a first pilot on the whole integrand; but
 * what is left is what is narrow and bright, and a second pilot, on what the first survey has left, tells how much dearer that is, up to the first
 * power, where the error of what is left is that of the whole. Bidirectional samples tell that share even where the path tracer itself would find
 * nothing for long. Spent in the best proportion, both together have (sqrt(a) + sqrt(b))^2. Scales the thresholds. */
void run_survey(Render *r)
{
    const Camera *camera = &r->scene->camera;
    Survey s = { .film = r->film, .picture = r->picture, .scale = r->tau > 0 ? 1 / r->tau : 1 };
    Space all = { .scene = r->scene, .max_depth = r->settings->max_depth, .direct = DIRECT_INCLUDED };
    Rng rng = rng_new(r->settings->seed, ((uint64_t)1 << 63) - 1);
    uint64_t *rays = r->scene->rays, before = *rays;
    double chain_rays = (double)(r->stats.chain_rays + r->stats.start_rays), most = SURVEY_SHARE * chain_rays, n_joined = 0, n_traced = 0;
    double began = clock_now();
    for (; n_joined < SURVEY || (double)(*rays - before) < most; n_joined++) {
        bdpt_sample(r->bdpt, &all, rng_double(&rng) * camera->width, rng_double(&rng) * camera->height, &rng, survey_candidate, &s);
        end_sample(&s.joined);
    }
    double joined_rays = (double)(*rays - before) / n_joined, joined_seconds = (clock_now() - began) / n_joined;
    began = clock_now();
    before = *rays;
    for (; n_traced < SURVEY || (double)(*rays - before) < most; n_traced++) {
        const Numbers numbers = numbers_random(&rng);
        path_trace(&all, rng_index(&rng, camera->width), rng_index(&rng, camera->height), &numbers, &rng, r->trail, survey_traced, &s);
        end_sample(&s.traced);
        end_sample(&s.direct);
    }
    double traced_rays = (double)(*rays - before) / n_traced, traced_seconds = (clock_now() - began) / n_traced, best = INFINITY, scale = r->tau > 0 ? r->tau : 1;
    /* A short pilot rather misses what is rare: its error is taken half as large again. */
    double error = 1.5 * run_chain_error(r) * chain_rays / (double)r->pixels, power = 0;
    if (r->tau == 0) r->whole_error = error > 0 ? error : UNKNOWN_ERROR;
    else if (r->left > 0 && error > 0) {
        power = fmin(fmax(log(error / (r->left * r->left) / r->whole_error) / fmax(-log(r->left), log(2)), 0), 1);
        if (power == 1) r->whole_error = fmin(error / r->left, MOST_ERROR * r->whole_error);
    }
    const double least[2] = { least_share(r, traced_seconds), least_share(r, joined_seconds * (joined_rays + DIRECT_RAYS) / joined_rays) };
    for (int joined = 0; joined < 2; joined++) {
        for (int i = 0; i < CUTS; i++) {
            double left = (joined ? s.joined : s.traced).left[i] / s.indirect, sampled;
            if (joined)
                sampled = (variance(&s.joined, i, n_joined, s.joined.moment[i] / n_joined) + variance(&s.direct, i, n_traced, s.direct.moment[i] / n_traced))
                    * (joined_rays + DIRECT_RAYS);
            else sampled = variance(&s.traced, i, n_traced, fmax(s.traced.moment[i] / n_traced, s.expected_moment[i] / n_joined)) * traced_rays;
            double above = (joined ? s.joined : s.traced).above[i];
            if ((i > 0 && !(left > 0)) || (i >= SURE_CUTS && above < LEAST_ABOVE)) break;   /* so few samples cannot tell that nothing is left */
            double path = sqrt(sampled), rest = left > 0 ? sqrt(r->whole_error * pow(left, 2 - power)) : 0;
            double both = together(path, rest, least[joined]);
            /* a higher cap has to promise something; where chains hardly matter, to cost nothing */
            if (both >= (path > ALONE * rest && r->bidirectional == joined ? 1.02 : 0.98) * best) continue;
            best = fmin(both, best);
            r->bidirectional = joined;
            r->tau = tau_of(i);
            r->left = left;
            r->direct_share = fmax(path / rest, least[joined] / (1 - least[joined]));
        }
        if (!joined && r->direct_share > ALONE) best *= EVEN;
    }
    for (size_t i = 0; i < r->pixels; i++) r->film[i].threshold = (float)(r->tau / scale * (double)r->film[i].threshold);
    if (!(r->direct_share < run_most_share(r))) r->direct_share = run_most_share(r);
}
