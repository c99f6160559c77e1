/* Where to divide the integrand between independent samples and chains, from what the pilot has left. See render.c for why. */
#include "run.h"

enum {
    FIRST_CUT = -8,                /* tau that are weighed: 2^-8 .. 2^9 times the picture's own value, and ALL_KEPT */
    SURE_CUTS = 14,                /* .. 2^5 whatever the survey has seen above them */
    LEAST_ABOVE = 32,              /* paths that it must have seen above a higher one: of what is brighter than all that it has seen it knows nothing */
    SURVEY = 4000,                 /* samples for that, of each kind, at least, */
    HASTY_SURVEY = 500,            /* but only so many if they take longer than SURVEY_TIME */
    DIRECT_MOST = 4,               /* times the picture's value: what a sample of direct light may count there */
    SEEN_MOST = 16,                /* times the picture's value: threshold of lamps seen by way of specular vertices */
    DIRECT_RAYS = 2,               /* of a sample of direct light alone */
    UNKNOWN_ERROR = 10,            /* error times rays of the chains where a pilot has been too short for any: what is usual */
    SPREAD_OVER = 100,             /* pixels over which chains spread a path that was met by chance, rather too few */
    MOST_ERROR = 32                /* of a second pilot over that of the first: rare paths may dominate it, of which it has had less than its share */
};
/* Samples of a path tracer fill their ranges more evenly than others, and err less than their variance says. That matters where they are on their own (rays per ray of the
 * chains) and rivalled by bidirectional ones: chains' errors are foretold too low. */
static const double ALONE = 20, EVEN = 0.7;
/* So few samples hardly see the tails of what is met by chance alone, and of what guesses find. By the walks that are bent, the error counts so many times. */
static const double DOUBT[BENDINGS] = { 1.25, 1, 1.5 };
/* Of the chains' error where none of them gets away from its seed: so much a pilot, which has few of them, does not foretell. */
static const double NOT_FORETOLD = 0.5;
static const double SURVEY_SHARE = 0.5, SURVEY_RAYS = 4e6;     /* of each kind such a share of the rays of the pilot's chains, up to so many */
static const double SURVEY_TIME = 0.25;    /* of what is left of a run's time, for all kinds */

/* What is capped is the path tracer's; or a bidirectional one has it, but for direct light where that is cheaper apart. */
void run_divide(Render *r)
{
    r->direct_space.direct = r->bidirectional ? DIRECT_ONLY : DIRECT_INCLUDED;
    r->direct_space.part = CAPPED;
    r->direct_space.seen = r->tau >= ALL_KEPT ? 1 : SEEN_MOST / r->tau;
    r->direct_space.bidirectional = r->chain_space.bidirectional = r->bidirectional;
    r->direct_space.bent = r->chain_space.bent = r->bent;
    r->joined_space = r->direct_space;
    r->joined_space.direct = r->bidirectional && r->direct_joined ? DIRECT_INCLUDED : DIRECT_EXCLUDED;
    r->chain_space.part = REST;
    r->chain_space.emission = r->bidirectional ? NULL : r->emission;
}

static bool joins(Way way) { return way >= JOINED; }
static BentWalks bends(Way way) { return (BentWalks)(way % BENDINGS); }
/* Whose samples find all that can be found, and so tell of all ways. */
static Way teller(const Render *r) { return r->scene->has_specular ? JOINED + BENT_ALL : JOINED; }

static void add_square(Moment *m, double x) { m->sum += x; m->square += x * x; }
/* Of one of n: few rare values may dominate it, and then it is rather too small. */
static double moment(const Moment *m, double n) { return (m->sum + 2 * sqrt(m->square)) / n; }

/* The path tracer's moment twice: of its own samples, which know how paths of one sample go together, and from bidirectional samples path by path,
 * which know what the path tracer finds too rarely. Direct light is bounded: a lamp that fills little of a pixel may be missing from the pilot's picture, and
 * one sample of it would decide. */
typedef struct {
    Render *render;
    double scale;
    Way way;                       /* whose samples are drawn */
    Space whole[BENDINGS], learned[BENDINGS];  /* learned: a bootstrap's, whose light subpaths leave their lamp by Render.emission */
    Surveyed *sum;
} Survey;

static double tau_of(int i) { return i == CUTS - 1 ? ALL_KEPT : ldexp(1, FIRST_CUT + i); }
static double kept(double value, double tau) { return value > tau ? tau / value : 1; }

/* 'seeds' are the path's values to the samples that seeds come from, of either kind. */
static void tell(Told *told, Reach reach, double share, double value, const double seeds[2], double to_tau)
{
    bool direct = reach_is_direct(reach);
    if (direct) value = fmin(value, DIRECT_MOST);
    else told->indirect += share;
    for (int i = 0; i < CUTS; i++) {
        double k = direct ? 1 : kept(to_tau * value, tau_of(i));
        told->left[i] += share * (1 - k);
        told->above[i] += k < 1;
        for (int j = 0; j < 2 && reach == REACH_INDIRECT; j++)
            if (isfinite(seeds[j])) add_square(&told->seeds[j][i], share * (1 - k) * (1 - k) * seeds[j]);
        if (!isfinite(value)) continue;
        add_square(&told->moment[i], share * k * k * value);
        if (reach == REACH_UNJOINED) told->met[i] += share * (1 - k) * (1 - k) * value;
    }
}

/* The values of a path to all ways and to bootstraps, relative to the picture. False if it is not to be told. */
static bool values_of(const Survey *s, const Candidate *c, double picture, double value[WAYS], double bootstrap[BENDINGS])
{
    Render *r = s->render;
    bool bent = r->scene->has_specular && bdpt_may_be_bent(r->bdpt, c), learned = emission_active(r->emission);
    if ((bent || learned) && !bdpt_path(r->bdpt, &s->whole[bends(s->way)], c->n_light, c->n_lens, r->x)) return false;
    for (BentWalks b = BENT_NONE; b < BENDINGS; b++) {
        value[TRACED + b] = (bent ? path_traced_value(&s->whole[b], r->x) : c->value) / picture;
        value[JOINED + b] = (bent ? path_bidirectional_value(&s->whole[b], r->x) : bdpt_value(r->bdpt, c)) / picture;
        bootstrap[b] = learned ? path_bidirectional_value(&s->learned[b], r->x) / picture : value[JOINED + b];
    }
    return isfinite(value[s->way]);
}

static void survey_candidate(void *context, const Candidate *c)
{
    Survey *s = context;
    const Render *r = s->render;
    double picture = (double)r->picture[c->pixel], to_tau = picture / (s->scale * (double)r->film[c->pixel].threshold);
    double light = luminance(c->rgb) / picture, value[WAYS], bootstrap[BENDINGS];
    bool direct = reach_is_direct(c->reach);
    if (!isfinite(light) || !values_of(s, c, picture, value, bootstrap)) return;
    if (s->way == teller(r)) {
        double share = direct ? fmin(light, DIRECT_MOST) : light;
        for (Way way = TRACED; way < WAYS; way++) {
            const double seeds[2] = { joins(way) ? value[way] : bootstrap[bends(way)], bootstrap[bends(teller(r))] };
            if (!joins(way) || !direct) tell(&s->sum->told[way], c->reach, share, value[way], seeds, to_tau);
        }
    }
    for (int i = 0; i < CUTS; i++) {
        double kept_light = direct ? fmin(light, DIRECT_MOST) : kept(to_tau * value[s->way], tau_of(i)) * light;
        for (int with = direct; with < 2; with++) {
            Capped *capped = with ? &s->sum->joined : &s->sum->capped[s->way];
            if (with && s->way != JOINED) continue;
            if (c->n_lens > 1) capped->own[i] += kept_light;
            else add_square(&capped->moment[i], kept_light * kept_light);
        }
    }
}

static void survey_traced(void *context, const Candidate *c)
{
    Survey *s = context;
    const Render *r = s->render;
    double picture = (double)r->picture[c->pixel], to_tau = picture / (s->scale * (double)r->film[c->pixel].threshold);
    double share = luminance(c->rgb) / picture, value = c->value / picture;
    if (!isfinite(share) || !(share > 0)) return;
    bool direct = reach_is_direct(c->reach);
    if (direct) share = fmin(share, DIRECT_MOST);
    for (int i = 0; i < CUTS; i++) {
        s->sum->capped[s->way].own[i] += share * (direct ? 1 : kept(to_tau * value, tau_of(i)));
        if (direct && s->way == TRACED) s->sum->direct.own[i] += share;
    }
}

static void end_sample(Capped *c)
{
    for (int i = 0; i < CUTS; i++) {
        add_square(&c->moment[i], c->own[i] * c->own[i]);
        c->mean[i] += c->own[i];
        c->own[i] = 0;
    }
}

/* Of what lands in one pixel; not less than a share of the moment, for so few samples know little of rare values. */
static double variance(const Capped *c, int i, double square)
{
    double mean = c->mean[i] / c->n;
    return fmax(square - mean * mean, 0.02 * square);
}

/* Draws samples of one way, until there are enough and they have had so many rays, or time is up. A second survey finds those of the first. */
static void draw(Survey *s, Way way, double most, double until)
{
    Render *r = s->render;
    const Camera *camera = &r->scene->camera;
    const Space *space = &s->whole[bends(way)];
    Capped *c = &s->sum->capped[way];
    uint64_t *rays = r->scene->rays, before = *rays;
    double began = clock_now(), drawn = c->rays;
    if (c->n == 0) c->rng = rng_new(r->settings->seed, ((uint64_t)1 << 63) - 1 - (uint64_t)way);
    for (s->way = way; c->n < SURVEY || c->rays < most; c->n++) {
        if (c->n >= HASTY_SURVEY && clock_now() > until) break;
        if (joins(way)) bdpt_sample(r->bdpt, space, rng_double(&c->rng) * camera->width, rng_double(&c->rng) * camera->height, BOTH_WAYS, NULL, &c->rng, survey_candidate, s);
        else {
            const Numbers numbers = numbers_random(&c->rng);
            path_trace(space, rng_index(&c->rng, camera->width), rng_index(&c->rng, camera->height), &numbers, &c->rng, r->trail, survey_traced, s);
        }
        end_sample(c);
        if (way == TRACED) end_sample(&s->sum->direct);
        if (way == JOINED) end_sample(&s->sum->joined);
        c->rays = drawn + (double)(*rays - before);
    }
    c->seconds += clock_now() - began;
}

/* Of one sample, times its rays. A bidirectional one has a path tracer's of direct light beside it, unless it has better all light itself. */
static double way_cost(const Surveyed *s, Way way, int i, bool may_join, bool *direct_joined)
{
    const Capped *c = &s->capped[way];
    const Told *told = &s->told[way];
    double by_capped = variance(c, i, fmax(moment(&c->moment[i], c->n), moment(&told->moment[i], told->n))) + told->met[i] / (told->n * SPREAD_OVER);
    double rays = c->rays / c->n;
    *direct_joined = false;
    if (!joins(way)) return by_capped * rays;
    double apart = (by_capped + EVEN * variance(&s->direct, i, moment(&s->direct.moment[i], s->direct.n))) * (rays + DIRECT_RAYS);
    double inside = fmax(by_capped, variance(&s->joined, i, moment(&s->joined.moment[i], s->joined.n))) * rays;
    *direct_joined = way == JOINED && may_join && inside < apart;
    return *direct_joined ? inside : apart;
}

static double way_seconds(const Surveyed *s, Way way)
{
    const Capped *c = &s->capped[way];
    return c->seconds / c->n * (joins(way) ? 1 + DIRECT_RAYS * c->n / c->rays : 1);
}

/* Variance times rays of samples for the seeds of what is left to the chains at a tau. */
static double of_seeds(const Surveyed *s, Way way, int i, BentWalks bent)
{
    const Told *told = &s->told[way];
    const Capped *c = &s->capped[JOINED + bent];
    return moment(&told->seeds[bent != bends(way)][i], told->n) * c->rays / c->n;
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
 * nothing for long. Spent in the best proportion, both together have (sqrt(a) + sqrt(b))^2. Where the samples' whole variance, without a cap, is less than the
 * best of that, nothing is left to the chains. Scales the thresholds. */
void run_survey(Render *r)
{
    Space all = { .scene = r->scene, .max_depth = r->settings->max_depth, .direct = DIRECT_INCLUDED, .film = r->film /* values are asked for */ };
    Surveyed *sum = &r->surveyed;
    Survey s = { .render = r, .scale = r->tau > 0 ? 1 / r->tau : 1, .whole = { all, all, all }, .sum = sum };
    for (BentWalks b = BENT_NONE; b < BENDINGS; b++) {
        s.whole[b].bent = b;
        s.learned[b] = s.whole[b];
        s.learned[b].emission = r->emission;
    }
    double chain_rays = (double)(r->stats.chain_rays + r->stats.start_rays), best = INFINITY, scale = r->tau > 0 ? r->tau : 1;
    double now = clock_now(), a_way = r->settings->seconds > 0 ? SURVEY_TIME * (r->settings->start + r->settings->seconds - now) / (r->scene->has_specular ? WAYS : 2) : INFINITY;
    for (Way way = TRACED; way < WAYS; way++)
        if (!bends(way) || r->scene->has_specular) draw(&s, way, fmin(SURVEY_SHARE * chain_rays, SURVEY_RAYS), now += a_way);
    sum->direct.n = sum->capped[TRACED].n;
    sum->joined.n = sum->capped[JOINED].n;
    for (Way way = TRACED; way < WAYS; way++) sum->told[way].n = sum->capped[teller(r)].n;
    /* A short pilot rather misses what is rare: its error is taken half as large again. */
    double error = 1.5 * run_chain_error(r) * chain_rays / (double)r->pixels, power = 0;
    if (r->tau == 0) r->whole_error = error > 0 ? error : UNKNOWN_ERROR;
    else if (r->left > 0 && error > 0) {
        power = fmin(fmax(log(error / (r->left * r->left) / r->whole_error) / fmax(-log(r->left), log(2)), 0), 1);
        if (power == 1) r->whole_error = fmin(error / r->left, MOST_ERROR * r->whole_error);
    }
    Way chosen = WAYS;
    for (Way way = TRACED; way < WAYS; way++) {
        const Told *told = &sum->told[way];
        double least = least_share(r, way_seconds(sum, way));
        if (way == JOINED && r->direct_share > ALONE) best *= EVEN;
        for (int i = 0; i < CUTS && sum->capped[way].n > 0; i++) {
            double left = told->left[i] / told->indirect;
            bool keeps_all = i == CUTS - 1, direct_joined;
            /* so few samples cannot tell that nothing is left, nor how bright the rare is that chains would spread */
            if (keeps_all ? told->above[SURE_CUTS - 1] < LEAST_ABOVE : (i > 0 && !(left > 0)) || (i >= SURE_CUTS && told->above[i] < LEAST_ABOVE)) continue;
            double path = sqrt(way_cost(sum, way, i, !r->scene->has_specular, &direct_joined)), rest = left > 0 ? sqrt(r->whole_error * pow(left, 2 - power)) : 0;
            /* the scale of all that chains bring is that of their seeds */
            BentWalks from = !joins(way) && r->scene->has_specular && of_seeds(sum, way, i, BENT_ALL) < 0.8 * of_seeds(sum, way, i, bends(way)) ? BENT_ALL : bends(way);
            double seeds = sqrt(of_seeds(sum, way, i, from) / (double)r->pixels);
            double both = together(path, rest + seeds, least) * DOUBT[bends(way)];
            if (keeps_all) both *= 1 - NOT_FORETOLD * r->persistence * r->persistence;
            /* a higher cap has to promise something; where chains hardly matter, to cost nothing */
            if (both >= (path > ALONE * rest && way == chosen && i < SURE_CUTS ? 1.02 : 0.98) * best) continue;
            best = fmin(both, best);
            chosen = way;
            r->bidirectional = joins(way);
            r->direct_joined = direct_joined;
            r->bent = bends(way);
            r->seeds_bent = from;
            r->catches = told->met[i] > 0;
            r->tau = tau_of(i);
            r->left = left;
            r->direct_share = fmax(path / rest, least / (1 - least));
        }
    }
    for (size_t i = 0; i < r->pixels; i++) r->film[i].threshold = (float)(r->tau / scale * (double)r->film[i].threshold);
    if (!(r->direct_share < run_most_share(r))) r->direct_share = run_most_share(r);
}
