/* Rounds and passes. See render.h.
 *
 * A Metropolis run is a row of independent rounds. Each has its own seeds, its own b, its own chains, and leaves an unbiased picture; the
 * result is their average, weighted by mutations. So b grows sharper as the run goes on, the spread between rounds tells the error (a
 * shared b would hide its own), and a round may use what earlier ones have learned: the two-stage weight w ~ 1/picture, and the shares of work.
 *
 * With direct light apart, the integrand is divided. The path tracer has all direct light; of an indirect path that it finds with a value above
 * tau times the picture it keeps so much that the value is just that, and all of the others; the chains get the rest. The path tracer's values
 * are bounded then, and the chains need not visit what is easy. (To cap the values leaves the chains the least for a given second moment.) Where it is better
 * at it, a bidirectional path tracer takes the path tracer's place for indirect light, or (direct_joined) for all; and where that pays, walks from the lens are bent to meet lamps
 * through specular vertices (bend.h). How much of a path is whose depends on the path and on thresholds that a pilot has set, whose own picture is thrown
 * away; that may leave the chains nothing (ALL_KEPT). The pilot looks for indirect light twice, by chains and by bidirectional samples.
 *
 * Bootstraps learn which way light leaves its lamp to any effect (emission.h), each round from all before it. While that soon makes seeds better there
 * are more pilots, so that no round of the picture hangs on one lucky find.
 *
 * Every round and every chain has its own random stream, so the state of a run is a few pictures and counters.
 */
#include "run.h"
#include "cache.h"
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum {
    WHOLE_PILOTS = 3, PILOTS = 6,  /* short rounds that teach, a hundredth of the work each, and are thrown away; while the integrand is whole, and all */
    MORE_PILOTS = 10,              /* at most, while seeds are soon better for what is learned */
    ROUNDS = 16,                   /* that make the picture */
    PILOT_SAMPLES = 65536,         /* of the path tracer, that a pilot begins with, on a film that has as many pixels */
    PILOT_STEPS = 64,              /* mutations per pixel that a pilot round needs at most */
    FREE_STEPS = 16,               /* mutations per pixel in a round of a run that only its error ends */
    LEARN_RAYS = 4,                /* per pixel after which it pays to learn again, and a quarter more than so far: that costs as much as some 0.2 */
    SURE_SHARE = 20,               /* rays of independent samples per ray of the chains: above it chains matter little */
    LEAST_PASSES = 3,              /* of samples that a run with chains must have time for, beside the pilot's */
    ALIKE_PASSES = 8,              /* of samples before it is settled which pixels are to have more */
    ROW_SHARE = 64,                /* of the film's rows are sampled in a round at least */
    MOST_A_SEED = 16,              /* chains */
    SLICE = 16384,                 /* steps between two looks at the clock */
    STREAM_BITS = 40               /* of a random stream's number, below the round's */
};

double clock_now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* That make the picture: none is without a chain. */
static uint64_t rounds_of_run(const Settings *s) { return s->chains > 0 && s->chains < ROUNDS ? s->chains : ROUNDS; }

/* No round yet. */
static void begin(Render *r)
{
    const Settings *s = r->settings;
    DirectClass all = s->direct == LIGHT_ONLY ? DIRECT_ONLY : s->direct == LIGHT_NONE ? DIRECT_EXCLUDED : DIRECT_INCLUDED;
    r->chain_space = r->direct_space = r->joined_space = (Space){ .scene = r->scene, .max_depth = s->max_depth, .direct = all, .film = r->film };
    if (r->has_chain) {
        r->direct_space.direct = DIRECT_ONLY;
        if (s->direct == LIGHT_APART) r->chain_space.direct = r->joined_space.direct = DIRECT_EXCLUDED;
        r->joined_space.bent = r->chain_space.bent = r->seeds_bent = r->scene->has_specular ? BENT_ALL : BENT_NONE;
        r->chain_space.emission = r->emission;
        memset(r->emission, 0, sizeof *r->emission);
    }
    r->pilot = r->has_chain;
    r->direct_share = 1;
    r->tau = 0;
    r->rounds = r->more_pilots = 0;
    r->seeds_before = 0;
    r->last_round = PILOTS + rounds_of_run(s);
}

Render *render_new(const Scene *scene, const Settings *settings)
{
    Render *r = calloc(1, sizeof *r);
    if (!r) return NULL;
    r->scene = scene;
    r->settings = settings;
    r->pixels = (size_t)scene->camera.width * scene->camera.height;
    r->has_chain = settings->integrator == INTEGRATOR_MLT && settings->direct != LIGHT_ONLY;
    r->has_direct = !r->has_chain || settings->direct == LIGHT_APART;
    r->bidirectional = settings->integrator == INTEGRATOR_BDPT;

    size_t doubles = 3 * r->pixels;
    bool ok = (r->bdpt = bdpt_new()) && (r->x = calloc(1, sizeof *r->x)) && (r->y = calloc(1, sizeof *r->y)) && (r->trail = calloc(1, sizeof *r->trail));
    if (r->has_direct)
        ok = ok && (r->passes.sum = calloc(doubles, 8)) && (r->passes.square = calloc(doubles, 8)) && (r->passes.direct = calloc(r->pixels, 8))
            && (r->passes.first = calloc(run_firsts(r), 8)) && (r->passes.often = calloc(r->pixels, 4)) && (r->passes.cost = calloc(r->pixels, 4))
            && (r->passes.count = calloc(scene->camera.height, 8)) && (r->passes.alike = calloc(scene->camera.height, 8));
    if (r->bidirectional || (r->has_chain && r->has_direct))
        ok = ok && (r->passes.light = calloc(doubles, 8)) && (r->passes.light_square = calloc(doubles, 8));
    if (r->has_chain)
        ok = ok && (r->emission = calloc(1, sizeof *r->emission)) && (r->met.seed = calloc(SEEDS, sizeof *r->met.seed)) && (r->picture = calloc(r->pixels, sizeof *r->picture))
            && (r->film = large_alloc(r->pixels * sizeof *r->film)) && (r->sum = calloc(doubles, 8)) && (r->square = calloc(doubles, 8));
    if (!ok) { render_free(r); return NULL; }
    for (size_t i = 0; r->has_chain && i < r->pixels; i++) r->film[i] = (Pixel){ .weight = 1 };
    begin(r);
    r->sampler = sampler_for(scene, settings->strategies);
    r->rate = 1e6;
    r->samples_rate = 1e4;
    r->samples_per_step = 0.2;
    r->rays_per_step = scene->n_lights > 0 ? 2 : 0;
    r->relative_error = NAN;
    return r;
}

void render_free(Render *r)
{
    if (!r) return;
    bdpt_free(r->bdpt);
    image_free(r->early);
    Passes *p = &r->passes;
    void *owned[] = { r->x, r->y, r->trail, p->sum, p->square, p->direct, p->first, p->often, p->cost, p->count, p->alike, p->light, p->light_square,
                      r->film, r->picture, r->met.seed, r->emission, r->sum, r->square, r };
    for (size_t i = 0; i < sizeof owned / sizeof *owned; i++) free(owned[i]);
}

static bool going(Render *r)
{
    if (!r->stopped && !r->keep_going(r->context, r)) r->stopped = true;
    return !r->stopped;
}

static bool in_time(const Render *r, double deadline) { return r->settings->seconds == 0 || clock_now() < deadline; }

/* ---- independent samples ---- */

/* That there are to be before the first chain: a pass, but of a pilot on a large film no more than it can learn from. */
static double first_rows(const Render *r)
{
    double height = r->scene->camera.height, enough = ceil((double)PILOT_SAMPLES / r->scene->camera.width);
    return r->pilot ? fmin(fmax(enough, 16), height) : height;
}

/* Whatever the clock or the user say: without a sample in every pixel there is no picture of what the path tracer is to bring. */
static bool one_pass(Render *r)
{
    double start = clock_now();
    while ((double)r->passes.rows < first_rows(r))
        if (!run_sample_row(r)) return false;
    r->stats.seconds_direct += clock_now() - start;
    return true;
}

/* ---- chains ---- */

static void clear_film(Render *r)
{
    for (size_t i = 0; i < r->pixels; i++) r->film[i] = (Pixel){ .weight = r->film[i].weight, .threshold = r->film[i].threshold };
}

static void splat_path(void *context, const Path *path, double weight)
{
    Render *r = context;
    Pixel *pixel = &r->film[path->pixel];
    double *sum = pixel->sum, scale = weight * path->share / path->chi;
    sum[0] += scale * path->colour.x;
    sum[1] += scale * path->colour.y;
    sum[2] += scale * path->colour.z;
    pixel->halves += (float)(r->half * weight);
    if (r->chain_space.emission) {
        const Vertex *lamp = &path->v[0];
        emission_see(r->emission, (uint32_t)(lamp->point.surface.material - r->scene->mesh.material), lamp->to_lens, dot(lamp->to_lens, lamp->point.surface.ng));
    }
}

/* Where the number of chains was asked for: of these in a round, *left in it and those after it. */
static double asked_chains_left(const Render *r, uint64_t round, double *left)
{
    double n = (double)r->settings->chains, all = (double)rounds_of_run(r->settings), i = fmod((double)round - PILOTS, all), before = floor(n * i / all);
    *left = n - before;
    return floor(n * (i + 1) / all) - before;
}
static double asked_chains(const Render *r, uint64_t round) { double left; return asked_chains_left(r, round, &left); }

/* Of what is left to do, the coming round's: all chains are of one length, where their number was asked for. */
static double round_share(const Render *r)
{
    double left;
    if (r->rounds < PILOTS) return 0.01;
    if (r->settings->chains == 0 || r->rounds >= r->last_round) return 1 / ((double)r->last_round - (double)r->rounds);
    double chains = asked_chains_left(r, r->rounds, &left);
    return chains / left;
}

/* How many chains share a round's steps: half as many as it is likely to have seeds that are worth one, for chains from the same heavy
 * seed would walk the same ground, and one long chain gets further than they. But where chains hardly get away from their seeds, so many that all
 * seeds have their due. Likely by earlier rounds: were it this one's own, the chains' length would depend on the weights, and the expectation would no
 * longer be exact. */
static double chain_number(const Render *r)
{
    const Settings *s = r->settings;
    double steps = r->round.planned, seeds = r->seeds > 0 ? r->seeds : 128;
    if (s->chains > 0) return fmax(1, fmin(steps, r->rounds <= PILOTS ? ceil((double)s->chains / ROUNDS) : asked_chains(r, r->rounds - 1)));
    double a_seed = fmin(0.5 / (1 - r->persistence), MOST_A_SEED);
    return floor(fmin(fmax(a_seed * seeds, 8), fmax(1, steps / 64)));
}

/* Of the chain under way: its share of the steps, so that all together are exactly as planned. */
static double chain_length(const Round *round)
{
    return floor(round->planned * (round->chain + 1) / round->chains) - floor(round->planned * round->chain / round->chains);
}

/* 1 / (sum of squared shares of the weight) */
static double effective_seeds(const Bootstrap *boot, const Render *r)
{
    double samples = r->met.rows * r->scene->camera.width, b = r->round.b;
    double squares = (boot->n > 0 ? boot->square / pow((double)boot->n, 2) : 0) + (samples > 0 ? r->met.square / (samples * samples) : 0);
    return b > 0 ? b * b / squares : 0;
}

/* For a round of so many steps: by the share of rays that was found best, but at least 1000, or where no clock presses 100000 for the run. */
static double bootstrap_samples(const Render *r, double steps)
{
    return fmax(r->settings->seconds > 0 ? 1000 : 100000.0 / ROUNDS, r->start_share * r->samples_per_step * steps);
}

/* A round's part of the time that is left, and of that the chains'. Returns theirs, in seconds. */
static double plan_time(const Render *r, Round *round)
{
    double now = clock_now(), time = (r->settings->start + r->settings->seconds - now) * round_share(r);
    round->chain_seconds = r->has_direct ? time / (1 + r->direct_share) : time;
    round->deadline = now + time;
    round->direct_deadline = round->deadline - round->chain_seconds;
    return round->chain_seconds;
}

/* How much the next round is to do, and until when; false if nothing is left. The first are pilots. */
static bool plan_round(Render *r)
{
    const Settings *s = r->settings;
    double total = s->per_pixel * (double)r->pixels;
    if (r->rounds >= PILOTS && total > 0 && r->steps_sum >= total) return false;    /* an earlier run has done as much */
    Round round = { .phase = DIRECT, .planned = INFINITY, .deadline = INFINITY, .direct_deadline = INFINITY };
    if (total == 0 && s->seconds == 0) round.planned = FREE_STEPS * (double)r->pixels;
    if (isinf(round.planned) && r->rounds >= r->last_round) return false;
    if (total > 0) round.planned = floor((total - r->steps_sum) * round_share(r) + 0.5);
    if (r->rounds < PILOTS) round.planned = fmin(round.planned, PILOT_STEPS * (double)r->pixels);
    double time = INFINITY;
    if (s->seconds > 0) {
        time = plan_time(r, &round);
        if (!(time > 0)) return false;
        round.planned = fmin(round.planned, floor(1.3 * r->rate * time) + 1);
    }
    double n = s->bootstrap ? ceil((double)s->bootstrap * (r->rounds < PILOTS ? 0.01 : 1.0 / ROUNDS)) : bootstrap_samples(r, round.planned);
    if (r->rays_per_step == 0 && s->bootstrap == 0) n = fmax(n, r->samples_per_step * round.planned);    /* the last one had nothing for chains to do */
    round.n_bootstrap = (uint64_t)fmin(n, fmin(4e7, fmax(256, 0.67 * r->samples_rate * time)));
    if (r->has_chain && r->bidirectional && s->bootstrap == 0) round.n_bootstrap = 0;      /* run_meet has it all */
    r->round = round;
    r->rounds++;
    return true;
}

/* Where there is a bootstrap, the others' finds count as if they were of so many samples. */
static void count_found(Render *r, const Bootstrap *boot)
{
    RenderStats *s = &r->stats;
    double samples = r->met.rows * r->scene->camera.width, n = boot->n > 0 ? (double)boot->n : samples, scale = samples > 0 ? n / samples : 0;
    s->bootstrap_samples += (uint64_t)n;
    s->bootstrap_hits += boot->hits + (uint64_t)r->met.hits;
    for (int c = 0; c < CLASSES; c++) {
        s->found[c].hits += boot->found[c].hits + (uint64_t)r->met.found[c].hits;
        s->found[c].weight += boot->found[c].weight + scale * r->met.found[c].weight;
        s->found[c].square += boot->found[c].square + scale * scale * r->met.found[c].square;
    }
}

/* b^, seeds, chains. False if memory runs out. */
static bool run_round(Render *r)
{
    Round *round = &r->round;
    double start = clock_now();
    uint64_t seed = r->settings->seed, stream = (r->rounds + (r->more_pilots << 16)) << STREAM_BITS, *rays = r->scene->rays, before = *rays;
    bool resumed = round->chains > 0;
    double total = r->settings->per_pixel > 0 ? r->settings->per_pixel * (double)r->pixels : INFINITY;
    Bootstrap boot;
    if (!bootstrap_new(&boot, round->n_bootstrap, seed, stream)) return false;
    boot.bent = r->seeds_bent;
    while (boot.done < boot.n) {
        bootstrap_sample(&boot, &r->chain_space, r->bdpt, SLICE);
        uint64_t drawn = *rays;
        if (boot.done == boot.n) continue;
        *rays = before;                        /* should the run be saved or end here: to be drawn anew */
        if (going(r)) { *rays = drawn; continue; }
        bootstrap_free(&boot);
        return true;
    }
    if (resumed) *rays = before;               /* it has been counted */
    else {
        round->b = boot.b + run_met(r, &round->met_variance);
        round->b_variance = boot.b_variance + round->met_variance;
        round->chains = chain_number(r);
        r->seeds = effective_seeds(&boot, r);
        clear_film(r);
        r->stats.bad_samples += boot.bad;
        count_found(r, &boot);
        r->stats.start_rays += *rays - before;
    }
    double began = clock_now(), seconds_start = began - start;
    r->stats.seconds_start += seconds_start;
    if (boot.n > 0) r->samples_rate = (double)boot.n / fmax(1e-6, seconds_start);
    double offset = (double)(rng_new(seed, stream - 1).s[0] >> 11) * 0x1p-53, steps_before = round->steps;
    /* the first slice is done whatever the clock says: without it there would be no picture of what is left to chains */
    while (round->chain < round->chains && going(r) && (round->steps == 0 || in_time(r, round->deadline)) && r->steps_sum + round->steps < total) {
        if (round->left == 0) {
            uint64_t c = (uint64_t)round->chain;
            round->left = chain_length(round);
            round->rng = rng_new(seed, stream + ((uint64_t)1 << (STREAM_BITS - 1)) + c);
            r->stats.chain.rejection = 0;
            double u = even(offset, c, 0) * round->b;
            if (u >= boot.b && round->b > boot.b) run_met_seed(r, (u - boot.b) / (round->b - boot.b), r->x);
            else if (!bootstrap_seed(&boot, &r->chain_space, r->bdpt, u / boot.b, r->x)) {
                double rest = r->settings->seconds > 0 ? ceil(r->rate * fmax(0, round->deadline - clock_now())) : INFINITY;
                round->steps = fmin(round->planned, rest);     /* nothing to be found: the round's picture is black */
                break;
            }
        }
        double second = floor(chain_length(round) / 2), n = fmin(round->left > second ? round->left - second : round->left, SLICE);
        r->half = round->left > second ? 1 : -1;
        before = *rays;
        chain_run(&r->chain_space, &r->sampler, r->x, r->y, (uint64_t)n, &round->rng, splat_path, r, &r->stats.chain);
        round->steps += n;
        round->left -= n;
        r->stats.chain_rays += *rays - before;
        if (round->left == 0) round->chain++;
    }
    bootstrap_free(&boot);
    double seconds = clock_now() - began;
    r->stats.seconds_chain += seconds;
    if (round->steps > steps_before && round->b > 0) r->rate = (round->steps - steps_before) / fmax(1e-6, seconds);
    if (round->b == 0) r->rays_per_step = 0;
    else if (r->stats.chain_rays > 0) r->rays_per_step = (double)r->stats.chain_rays / (r->steps_sum + round->steps);
    if (boot.n > 0 && r->stats.start_rays > 0 && r->rays_per_step > 0)
        r->samples_per_step = r->rays_per_step * (double)r->stats.bootstrap_samples / (double)r->stats.start_rays;
    return true;
}

/* Adds the round's chains to those of finished rounds. */
void run_close_chains(Render *r)
{
    double n = r->round.steps;
    if (n > 0) {
        double scale = r->round.b * (double)r->pixels / n, light[TILES_ACROSS * TILES_ACROSS] = { 0 }, apart = 0;
        size_t values[TILES_ACROSS * TILES_ACROSS] = { 0 };
        size_t i = 0;
        for (uint32_t y = 0; y < r->scene->camera.height; y++)
            for (uint32_t x = 0; x < r->scene->camera.width; x++) {
                const Pixel *pixel = &r->film[i / 3];
                uint32_t tile = run_tile(r, x, y);
                values[tile] += 3;
                apart += pow(scale * (double)pixel->halves, 2);
                for (int channel = 0; channel < 3; channel++, i++) {
                    double value = scale * pixel->sum[channel];
                    r->sum[i] += n * value;
                    r->square[i] += n * value * value;
                    light[tile] += value;
                }
            }
        for (uint32_t t = 0; t < run_tiles(r); t++) {
            double value = light[t] / (double)values[t];
            r->tile[t].sum += n * value;
            r->tile[t].square += n * value * value;
            r->tile[t].largest = fmax(r->tile[t].largest, n * value);
        }
        r->apart_sum += n * n * apart;
        r->steps_sum += n;
        r->steps_square += n * n;
        r->b_sum += n * r->round.b;
        r->b_variance_sum += n * n * r->round.b_variance;
        r->met_variance_sum += n * n * r->round.met_variance;
        r->stats.b = r->b_sum / r->steps_sum;
    }
    r->round.steps = r->round.b = r->round.b_variance = r->round.met_variance = 0;
    run_forget_met(r);
}

/* Forgets what chains have done but for what it has taught. */
static void forget_chains(Render *r)
{
    size_t bytes = 3 * r->pixels * sizeof(double);
    memset(r->sum, 0, bytes);
    memset(r->square, 0, bytes);
    clear_film(r);
    memset(r->tile, 0, sizeof r->tile);
    memset(r->stats.found, 0, sizeof r->stats.found);
    r->steps_sum = r->steps_square = r->b_sum = r->b_variance_sum = r->met_variance_sum = r->apart_sum = 0;
    r->seeds = 0;
    r->relative_error = NAN;
    r->stats.bootstrap_samples = r->stats.bootstrap_hits = 0;
    r->stats.b = 0;
    r->stats.start_rays = r->stats.chain_rays = 0;
    r->stats.seconds_start += r->stats.seconds_chain + r->stats.seconds_direct;
    r->stats.seconds_chain = r->stats.seconds_direct = 0;
}

/* Whether a pass of samples, of which the pilot needs one and the picture two, is short beside the run. Some rows tell. False if memory runs out. */
static bool time_for_pilot(Render *r, bool *enough)
{
    double start = clock_now(), seconds = r->settings->start + r->settings->seconds - start, height = r->scene->camera.height;
    while (r->passes.rows < r->scene->camera.height && r->passes.rows < 16 && clock_now() - start < 0.02 * seconds)
        if (!run_sample_row(r)) return false;
    double pass = (clock_now() - start) / (double)r->passes.rows * height;
    *enough = pass * (LEAST_PASSES + first_rows(r) / height) < seconds;
    return true;
}

/* Where there is no time for more: no cap, no pilot, and nothing for the chains. */
static void trace_all(Render *r)
{
    run_forget_samples(r);
    r->tau = INFINITY;
    for (size_t i = 0; i < r->pixels; i++) r->film[i].threshold = INFINITY;
    run_divide(r);
    r->direct_share = run_most_share(r);
    r->rounds = PILOTS;
    r->pilot = false;
}

/* Whether a pilot's seeds, which learn from those before, were so much better than the last one's, or none yet, that the next one's may be better still. */
static bool learns_fast(Render *r)
{
    bool fast = r->seeds > 2 * r->seeds_before || r->seeds == 0;
    r->seeds_before = r->seeds;
    return fast && r->chain_space.emission && (r->seeds == 0 || emission_active(r->emission)) && r->more_pilots < MORE_PILOTS;
}

/* After a pilot round. False if memory runs out. */
static bool learn_from_pilot(Render *r)
{
    sampler_tune(&r->sampler, r->scene, &r->stats.chain);
    r->stats.chain = (ChainCount){ .bad = r->stats.chain.bad };
    bool fast = learns_fast(r);
    if (r->rounds != PILOTS && !(r->has_direct && r->rounds == WHOLE_PILOTS)) return true;
    if (fast) {
        r->rounds--;
        r->more_pilots++;
        return true;
    }
    if (r->has_direct) {
        if (!r->early) {
            Image *picture = image_new(r->scene->camera.width, r->scene->camera.height);
            if (!picture) return false;
            render_image(r, picture);
            r->early = picture;
        }
        run_survey(r);
        run_divide(r);
        if (r->direct_share > SURE_SHARE) r->rounds = PILOTS;      /* however dear what is left, it is little: no more pilots */
        if (r->rounds < PILOTS) r->direct_share = 1;
    }
    forget_chains(r);
    r->pilot = r->rounds < PILOTS;
    if (!r->has_direct || r->pilot) return true;
    run_forget_samples(r);
    return one_pass(r);
}

/* Rows that the path tracer has to have done by the end of this round, whatever its share of rays: two passes tell its variance, and where the
 * chains have found nothing in the last round it works in their place, a sample for each mutation. */
static double least_rows(const Render *r)
{
    double height = r->scene->camera.height, rounds = (double)r->rounds, least = rounds <= PILOTS ? first_rows(r) : height * fmin(2 * (rounds - PILOTS), 4);
    const Settings *s = r->settings;
    double in_round = s->per_pixel > 0 ? s->per_pixel / (double)rounds_of_run(s) : s->seconds > 0 ? 0 : FREE_STEPS;
    return r->rays_per_step > 0 || rounds <= PILOTS + 1 ? least : fmax(least, in_round * height * (rounds - PILOTS));
}

/* An interruption leaves the round as it stands, to be gone on with. */
static bool run_chains(Render *r)
{
    const Settings *s = r->settings;
    bool enough = true;
    if (r->has_direct && r->pilot && s->seconds > 0 && r->passes.rows == 0 && !time_for_pilot(r, &enough)) return false;
    if (!enough) trace_all(r);
    if (r->has_direct && !one_pass(r)) return false;
    while (going(r)) {
        bool good_enough = s->error > 0 && r->rounds > PILOTS + 3 && r->relative_error <= s->error;
        if (r->round.phase == PLAN && (good_enough || !plan_round(r))) break;
        double start = clock_now();
        if (r->round.phase == DIRECT) {
            bool planned = s->seconds > 0 && r->rounds > WHOLE_PILOTS, timed = planned && s->per_pixel == 0;
            /* the total may be less than planned where a run is resumed with less to do */
            double total = s->per_pixel > 0 ? s->per_pixel * (double)r->pixels : INFINITY;
            double least = least_rows(r), rays = r->direct_share * r->rays_per_step * fmin(r->round.planned, total - r->steps_sum);
            double deadline = planned ? r->round.direct_deadline : s->start + s->seconds;
            while (r->has_direct && going(r)) {
                bool on = (timed || (double)r->passes.rows < least || r->met.rays < rays) && in_time(r, deadline);
                if (!on && ROW_SHARE * r->met.rows >= (double)r->scene->camera.height) break;   /* no round is without a sample of all parts of the film */
                if (!run_sample_row(r)) return false;
            }
            /* what that took longer is not the chains' loss */
            if (planned) r->round.deadline = fmin(fmax(r->round.deadline, clock_now() + r->round.chain_seconds), s->start + s->seconds);
            r->stats.seconds_direct += clock_now() - start;
            if (!going(r)) break;
            r->round.phase = CHAINS;
        }
        if (!run_round(r)) return false;
        if (!going(r)) break;
        run_close_chains(r);
        if (r->chain_space.emission) emission_learn(r->emission);
        if (run_begun(r)) {
            image_free(r->early);
            r->early = NULL;
        }
        bool due = r->pilot ? r->chain_space.part == WHOLE : (double)*r->scene->rays >= fmax(r->learned + LEARN_RAYS * (double)r->pixels, 1.25 * r->learned);
        if (due || r->rounds == r->last_round) {
            start = clock_now();
            run_learn(r);
            r->stats.seconds_start += clock_now() - start;
        }
        if (r->rounds <= PILOTS && !learn_from_pilot(r)) return false;
        if (r->has_direct && !r->pilot && !r->passes.settled && isfinite(r->tau) && r->passes.rows >= ALIKE_PASSES * (uint64_t)r->scene->camera.height) run_share_out(r);
        r->round.phase = PLAN;
    }
    return true;
}

static bool run_passes(Render *r)
{
    const Settings *s = r->settings;
    uint64_t height = r->scene->camera.height, rows = s->per_pixel > 0 ? (uint64_t)ceil(s->per_pixel * (double)height) : UINT64_MAX, look = 2 * height;
    if (!one_pass(r)) return false;
    double start = clock_now();
    while (r->passes.rows < rows && going(r) && in_time(r, s->start + s->seconds)) {
        if (!run_sample_row(r)) return false;
        if (r->passes.rows < look) continue;
        look += look / 4 + height;                 /* the estimate costs a pass over the picture: at growing intervals */
        look -= look % height;
        run_learn(r);
        if (s->error > 0 && r->relative_error <= s->error) break;
    }
    r->stats.seconds_direct += clock_now() - start;
    run_learn(r);
    return true;
}

/* Where nothing is left of what an earlier run was asked for, a resumed one ends at once; with more asked for it has as many rounds again for
 * the rest. A round that was interrupted goes on, on this run's clock. One that had no time for chains begins anew if there is time now. */
void run_go_on(Render *r)
{
    double left = r->settings->seconds > 0 ? r->settings->start + r->settings->seconds - clock_now() : INFINITY;
    if (isinf(r->tau) && LEAST_PASSES * r->stats.seconds_direct / (double)r->passes.rows * r->scene->camera.height < left) {
        run_forget_samples(r);
        r->stats = (RenderStats){ .b = 0 };
        r->round = (Round){ .phase = PLAN };
        begin(r);
    }
    if (r->round.phase == PLAN) {
        if (r->rounds >= r->last_round) r->last_round = r->rounds + rounds_of_run(r->settings);
    } else if (r->settings->seconds > 0) {     /* deadlines were of another clock */
        r->rounds--;
        plan_time(r, &r->round);
        r->rounds++;
    } else r->round.deadline = r->round.direct_deadline = INFINITY;
}

bool render_run(Render *r, bool (*keep_going)(void *, const Render *), void *context)
{
    r->keep_going = keep_going;
    r->context = context;
    return r->has_chain ? run_chains(r) : run_passes(r);
}

RenderStats render_stats(const Render *r)
{
    RenderStats s = r->stats;
    const Round *round = &r->round;
    double steps = r->steps_sum + round->steps, b = r->b_sum + round->steps * round->b;
    s.mutations = r->has_chain ? s.chain.steps : r->passes.rows * r->scene->camera.width;
    s.rays = *r->scene->rays;
    s.b = steps > 0 ? b / steps : 0;
    s.b_stderr = steps > 0 ? sqrt(r->b_variance_sum + round->steps * round->steps * round->b_variance) / steps : 0;
    s.relative_error = r->relative_error;
    s.tau = r->tau;
    s.bidirectional = r->bidirectional;
    s.bent = r->bent;
    s.bad_samples += s.chain.bad;
    return s;
}

uint32_t render_width(const Render *r) { return r->scene->camera.width; }
uint32_t render_height(const Render *r) { return r->scene->camera.height; }
