/* The estimators agree: path tracer, bidirectional path tracer and Metropolis sampler give one picture, tile by tile, whichever way direct
 * light is computed and however short paths must be; the furnace gives its closed form; b is the mean luminance. The unit of variance is the
 * independent run. Planted faults must be caught by the same comparisons.
 *
 *     test_agree [FACTOR [SEED]]        FACTOR times the samples, for a long run; another seed
 */
#include "balance.h"
#include "bend.h"
#include "check.h"
#include "folder.h"
#include "run.h"
#include "statistics.h"
#include "test_faults.h"

/* A false alarm of the whole program once in a million. */
enum { COMPARISONS = 5000 };
static int comparisons;

static double factor = 1;
static uint64_t seed = 1;

/* ---- runs and their comparison ---- */

enum { FILM = 16, TILES = 4, RUNS = 20, VALUES = TILES * TILES + 4 };   /* luminance of each tile and of all, then red, green, blue of all */

/* Independent runs of one estimator. */
typedef struct {
    int runs;
    double value[RUNS][VALUES];
} Group;

static bool always(void *context, const Render *render) { (void)context; (void)render; return true; }

static void add_pixel(double value[VALUES], uint32_t x, uint32_t y, Rgb c, double share)
{
    value[(y * TILES / FILM) * TILES + x * TILES / FILM] += share * TILES * TILES * luminance(c);
    value[TILES * TILES] += share * luminance(c);
    value[TILES * TILES + 1] += share * c.x;
    value[TILES * TILES + 2] += share * c.y;
    value[TILES * TILES + 3] += share * c.z;
}

typedef struct { double path, bdpt, mlt, bootstrap; } Effort;           /* samples or mutations per pixel; bootstrap samples per run */

static Group render_group(const Scene *scene, Integrator integrator, DirectLight direct, int max_depth, Effort effort)
{
    static uint64_t stream;                        /* a seed for each run of the program */
    Group g = { .runs = RUNS };
    for (int i = 0; i < RUNS; i++) {
        Settings s = {
            .integrator = integrator, .direct = direct, .max_depth = max_depth, .strategies = ~0u, .seed = seed * 1000000 + stream++,
            .per_pixel = factor * (integrator == INTEGRATOR_PATH ? effort.path : integrator == INTEGRATOR_BDPT ? effort.bdpt : effort.mlt),
            .bootstrap = (uint64_t)(factor * effort.bootstrap),
        };
        Render *r = render_new(scene, &s);
        Image *image = image_new(FILM, FILM);
        if (!CHECK(r && image && render_run(r, always, NULL))) { g.runs = 0; break; }
        render_image(r, image);
        for (uint32_t y = 0; y < FILM; y++)
            for (uint32_t x = 0; x < FILM; x++) add_pixel(g.value[i], x, y, from_float(image->rgb + 3 * (y * FILM + x)), 1.0 / (FILM * FILM));
        CHECK(render_stats(r).bad_samples == 0);
        render_free(r);
        image_free(image);
    }
    return g;
}

static void moments(const Group *g, int v, double *mean, double *variance)
{
    mean_and_variance(&g->value[0][v], VALUES, g->runs, mean, variance);
}

typedef enum { BY_TILES, AS_A_WHOLE } Detail;

/* The smallest chance of any value's difference, by Welch's test. */
static double least_chance(const Group *a, const Group *b, Detail detail, int *worst)
{
    double least = 1;
    *worst = -1;
    for (int v = detail == BY_TILES ? 0 : TILES * TILES; v < VALUES; v++) {
        double mean_a, mean_b, variance_a, variance_b;
        moments(a, v, &mean_a, &variance_a);
        moments(b, v, &mean_b, &variance_b);
        comparisons++;
        if (fabs(mean_a - mean_b) <= 1e-6 * fabs(mean_a)) continue;      /* exact pixels, or black ones */
        double t, chance = welch_chance(mean_a, variance_a, a->runs, mean_b, variance_b, b->runs, &t);
        if (chance < least || isnan(chance)) { least = chance; *worst = v; }      /* a NaN stays */
    }
    return least;
}

static const double CHANCE = 1e-6 / COMPARISONS;

static void agree(const char *name, const Group *a, const Group *b, Detail detail)
{
    int worst;
    double chance = least_chance(a, b, detail, &worst), mean_a, mean_b, variance_a, variance_b, error;
    moments(a, TILES * TILES, &mean_a, &variance_a);
    moments(b, TILES * TILES, &mean_b, &variance_b);
    error = sqrt(variance_a + variance_b) / mean_a;
    printf("    %-34s ratio of means %.4f +- %.4f, least chance %.1g\n", name, mean_a > 0 ? mean_b / mean_a : 1, mean_a > 0 ? error : 0, chance);
    if (!CHECK(chance > CHANCE)) printf("    value %d\n", worst);
}

static void disagree(const char *name, const Group *a, const Group *b, Detail detail)
{
    int worst;
    double chance = least_chance(a, b, detail, &worst);
    printf("    planted: %-60s chance %.1g\n", name, chance);
    CHECK(chance < CHANCE);
}

static Group sum(const Group *a, const Group *b)
{
    Group g = *a;
    for (int i = 0; i < g.runs; i++)
        for (int v = 0; v < VALUES; v++) g.value[i][v] += b->value[i][v];
    return g;
}

static bool load(Scene *scene, const char *file)
{
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_size = true, .width = FILM, .height = FILM };
    bool ok = scene_load(scene, file, &camera, BVH_FAST, &report);
    if (!CHECK(ok)) printf("%s: %s\n", file, report.error);
    return ok;
}

/* ---- every scene, every way of direct light ---- */

static void test_scenes(void)
{
    /* How far the independent estimators can be trusted: where light is found by paths of huge weight alone, a run has a handful of them,
     * and its mean is no normal variable. There the Metropolis runs are compared with each other by tiles, the others as a whole or not at all. */
    static const struct { const char *file; int max_depth; bool path, bdpt, path_none; Effort effort; } list[] = {
        { "scenes/cornell.obj", 8, true, true, true, { 48, 16, 96, 4000 } },
        { "scenes/cornell.obj", 3, true, true, true, { 48, 16, 96, 4000 } },
        { "scenes/caustic.obj", 8, false, true, false, { 48, 24, 96, 6000 } },
        { "scenes/pool.obj", 8, false, false, false, { 48, 16, 96, 40000 } },     /* one seed in some ten thousand has a large part of b */
        { "scenes/glossy.obj", 6, true, true, true, { 48, 24, 96, 6000 } },
        { "scenes/door.obj", 12, false, true, false, { 48, 16, 96, 4000 } },
        { "test/scenes/mirror-smooth.obj", 6, false, false, false, { 48, 24, 96, 6000 } },
        { "test/scenes/water-smooth.obj", 6, false, false, false, { 64, 24, 96, 6000 } },
        { "test/scenes/underwater.obj", 6, true, false, false, { 64, 24, 96, 6000 } },
        { "test/scenes/direct.obj", 6, true, true, false, { 48, 24, 96, 6000 } },
        { "test/scenes/lens-dof.obj", 5, true, true, false, { 48, 24, 96, 6000 } },
        { "test/scenes/narrow.obj", 6, true, true, false, { 48, 24, 96, 6000 } },
        { "test/scenes/texture.obj", 4, true, true, true, { 48, 16, 96, 4000 } },
        { "test/scenes/lamps.obj", 5, true, true, true, { 48, 24, 96, 6000 } },
    };
    for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
        Scene scene;
        if (!load(&scene, list[i].file)) continue;
        int depth = list[i].max_depth;
        Effort effort = list[i].effort;
        printf("%s, paths of up to %d edges\n", list[i].file, depth);
        Group apart = render_group(&scene, INTEGRATOR_MLT, LIGHT_APART, depth, effort), chain = render_group(&scene, INTEGRATOR_MLT, LIGHT_CHAIN, depth, effort);
        Group none = render_group(&scene, INTEGRATOR_MLT, LIGHT_NONE, depth, effort), only = render_group(&scene, INTEGRATOR_MLT, LIGHT_ONLY, depth, effort);
        Group path_only = render_group(&scene, INTEGRATOR_PATH, LIGHT_ONLY, depth, effort), bdpt_only = render_group(&scene, INTEGRATOR_BDPT, LIGHT_ONLY, depth, effort);
        Group both = sum(&none, &only);
        double mean, variance;
        moments(&apart, TILES * TILES, &mean, &variance);
        CHECK(mean > 0);                           /* black pictures would agree */
        agree("mlt: apart, chain", &apart, &chain, BY_TILES);
        agree("mlt: apart, none + only", &apart, &both, BY_TILES);
        agree("only: path, mlt", &path_only, &only, BY_TILES);
        agree("only: path, bdpt", &path_only, &bdpt_only, BY_TILES);
        if (list[i].bdpt || list[i].path) {
            Group path = render_group(&scene, INTEGRATOR_PATH, LIGHT_APART, depth, effort), bdpt = render_group(&scene, INTEGRATOR_BDPT, LIGHT_APART, depth, effort);
            Detail detail = list[i].path && list[i].bdpt ? BY_TILES : AS_A_WHOLE;
            if (list[i].bdpt) agree("all: bdpt, mlt apart", &bdpt, &apart, detail);
            if (list[i].bdpt) agree("all: bdpt, mlt chain", &bdpt, &chain, detail);
            if (list[i].path) agree("all: path, mlt apart", &path, &apart, detail);
            if (list[i].path && list[i].bdpt) {
                Group bdpt_none = render_group(&scene, INTEGRATOR_BDPT, LIGHT_NONE, depth, effort), path_none = render_group(&scene, INTEGRATOR_PATH, LIGHT_NONE, depth, effort);
                Group path_both = sum(&path_none, &path_only), bdpt_both = sum(&bdpt_none, &bdpt_only);
                agree("all: path, bdpt", &path, &bdpt, BY_TILES);
                agree("none: bdpt, mlt", &bdpt_none, &none, BY_TILES);
                if (list[i].path_none) agree("none: path, bdpt", &path_none, &bdpt_none, BY_TILES);
                if (list[i].path_none) agree("path: all, none + only", &path, &path_both, BY_TILES);
                agree("bdpt: all, none + only", &bdpt, &bdpt_both, BY_TILES);
            }
        }
        scene_free(&scene);
    }
}

/* ---- the same with small errors, and planted faults ---- */

/* A Metropolis run by hand, for rows that are not those of mutation_table. */
static void splat(void *context, const Path *x, double weight)
{
    add_pixel(context, (uint32_t)x->raster_x, (uint32_t)x->raster_y, x->colour, weight * x->share / x->chi);
}

/* Fault: as if the whole of f were left to the chains. */
static void splat_whole(void *context, const Path *x, double weight)
{
    add_pixel(context, (uint32_t)x->raster_x, (uint32_t)x->raster_y, x->colour, weight / x->chi);
}

static Group chain_group(const Space *space, const Sampler *sampler, uint64_t bootstrap, uint64_t chains, uint64_t steps,
                         void (*record)(void *, const Path *, double))
{
    Group g = { .runs = RUNS };
    Bdpt *bdpt = bdpt_new();
    Path *x = calloc(1, sizeof *x), *y = calloc(1, sizeof *y);
    ChainCount count = { 0 };
    for (int i = 0; i < RUNS; i++) {
        Bootstrap boot;
        if (!bootstrap_run(&boot, space, bdpt, bootstrap, seed, (uint64_t)(i + 1) << 32)) { CHECK(false); break; }
        Rng rng = rng_new(seed, (uint64_t)(i + 1) << 33);
        double offset = rng_double(&rng);
        for (uint64_t c = 0; c < chains; c++)
            if (bootstrap_seed(&boot, space, bdpt, even(offset, c, 0), x)) chain_run(space, sampler, x, y, steps, &rng, record, g.value[i], &count);
        for (int v = 0; v < VALUES; v++) g.value[i][v] *= boot.b / (double)(chains * steps);
        bootstrap_free(&boot);
    }
    CHECK(count.bad == 0);
    bdpt_free(bdpt);
    free(x);
    free(y);
    return g;
}

static void test_precisely(void)
{
    Scene scene;
    if (!load(&scene, "scenes/cornell.obj")) return;
    Effort effort = { 400, 100, 400, 80000 };
    int depth = 6;
    printf("scenes/cornell.obj precisely, paths of up to %d edges\n", depth);
    Group path = render_group(&scene, INTEGRATOR_PATH, LIGHT_APART, depth, effort), bdpt = render_group(&scene, INTEGRATOR_BDPT, LIGHT_APART, depth, effort);
    Group mlt = render_group(&scene, INTEGRATOR_MLT, LIGHT_APART, depth, effort);
    agree("path, bdpt", &path, &bdpt, BY_TILES);
    agree("path, mlt", &path, &mlt, BY_TILES);
    agree("bdpt, mlt", &bdpt, &mlt, BY_TILES);

    Space space = { .scene = &scene, .max_depth = depth, .direct = DIRECT_INCLUDED };
    Sampler sampler = sampler_for(&scene, 1u << BIDIR);
    uint64_t n = (uint64_t)(20000 * factor), chains = (uint64_t)(1000 * factor);
    Group by_hand = chain_group(&space, &sampler, n, chains, 30, splat);
    agree("path, bidir by hand", &path, &by_hand, BY_TILES);
    Group b = { .runs = RUNS };                    /* b of independent bootstraps, beside the path tracer's mean luminance */
    for (int i = 0; i < RUNS; i++) {
        Bdpt *work = bdpt_new();
        Bootstrap boot;
        if (bootstrap_run(&boot, &space, work, n, seed + 1, (uint64_t)(i + 1) << 32))
            for (int v = TILES * TILES; v < VALUES; v++) b.value[i][v] = v == TILES * TILES ? boot.b : path.value[i][v];
        bootstrap_free(&boot);
        bdpt_free(work);
    }
    agree("mean luminance of path, b", &path, &b, AS_A_WHOLE);

    Mutation table[MUTATIONS];
    memcpy(table, mutation_table, sizeof table);
    table[BIDIR].propose = bidir_one_way;
    sampler.table = table;
    Group one_way = chain_group(&space, &sampler, n, chains, 30, splat);
    disagree("path, bidir with T of the way taken alone", &path, &one_way, BY_TILES);
    scene_free(&scene);
}

/* Runs of the path tracer by hand, in a space that a Render does not make. */
static Group traced_group(const Space *space, int per_pixel)
{
    Group g = { .runs = RUNS };
    Path *trail = calloc(1, sizeof *trail);
    if (!trail) abort();
    for (int i = 0; i < RUNS; i++) {
        Rng rng = rng_new(seed, ((uint64_t)i + 1) << 34);
        for (int n = 0; n < per_pixel * FILM * FILM; n++) {
            uint32_t x = (uint32_t)n % FILM, y = (uint32_t)n / FILM % FILM;
            const Numbers numbers = numbers_random(&rng);
            add_pixel(g.value[i], x, y, path_trace(space, x, y, &numbers, &rng, trail, NULL, NULL), 1.0 / (per_pixel * FILM * FILM));
        }
    }
    free(trail);
    return g;
}

/* What a bidirectional sample says of the path tracer's value of a path, against the path itself. */
typedef struct { Bdpt *bdpt; const Space *space; Path *path, *trail; double worst, worst_joined; int n, short_ones; } Values;

static void compare_value(void *context, const Candidate *c)
{
    Values *v = context;
    if (!bdpt_path(v->bdpt, v->space, c->n_light, c->n_lens, v->path)) return;
    v->worst = fmax(v->worst, fabs(c->value / path_traced_value(v->space, v->path) - 1));
    v->worst_joined = fmax(v->worst_joined, fabs(bdpt_value(v->bdpt, c) / path_bidirectional_value(v->space, v->path) - 1));
    v->n++;
    v->short_ones += v->path->k == 1;
}

/* Its value and its share in the space against the path's own. */
static void compare_share(void *context, const Candidate *c)
{
    Values *v = context;
    if (reach_is_direct(c->reach) || (v->trail && c->n_light > 0)) return;
    if (!(v->space->bidirectional ? bdpt_path(v->bdpt, v->space, c->n_light, c->n_lens, v->path) : path_trailed(v->space, v->trail, c->n_lens, v->path))) return;
    double value = v->space->bidirectional ? path_bidirectional_value(v->space, v->path) : path_traced_value(v->space, v->path);
    v->worst = fmax(v->worst, fmax(fabs(c->value / value - 1), fabs(c->share / v->path->share - 1)));
    v->n++;
}

static void test_values(const Space *space)
{
    Values v = { .bdpt = bdpt_new(), .space = space, .path = calloc(1, sizeof(Path)) };
    Rng rng = rng_new(seed, 99);
    for (int i = 0; i < 5000; i++) bdpt_sample(v.bdpt, space, rng_double(&rng) * FILM, rng_double(&rng) * FILM, BOTH_WAYS, NULL, &rng, compare_value, &v);
    printf("    value of a path to the path tracer, two ways, %d paths, %d of them of one edge: %.2g apart; to the bidirectional one: %.2g\n", v.n, v.short_ones,
           v.worst, v.worst_joined);
    CHECK(v.n > 1000 && v.short_ones > 0 && v.worst < 1e-9 && v.worst_joined < 1e-9);
    bdpt_free(v.bdpt);
    free(v.path);
}

/* No sample of one path is worth more than the threshold, long paths and their roulette included. */
typedef struct { const Space *space; double most; int above; } Bound;

static void compare_bound(void *context, const Candidate *c)
{
    Bound *b = context;
    if (reach_is_direct(c->reach)) return;
    double worth = luminance(c->rgb), threshold = (double)b->space->film[c->pixel].threshold;
    b->most = fmax(b->most, c->share * worth / threshold);
    b->above += worth > threshold;
}

static void test_bound(const Space *capped)
{
    Space path = *capped, joined = *capped;
    path.max_depth = joined.max_depth = 32;
    joined.direct = DIRECT_EXCLUDED;
    joined.bidirectional = true;
    Bound by_path = { .space = &path }, by_both = { .space = &joined };
    Bdpt *bdpt = bdpt_new();
    Path *trail = calloc(1, sizeof *trail);
    if (!bdpt || !trail) abort();
    Rng rng = rng_new(seed, 98);
    for (int i = 0; i < 40000; i++) {
        const Numbers numbers = numbers_random(&rng);
        path_trace(&path, (uint32_t)i % FILM, (uint32_t)i / FILM % FILM, &numbers, &rng, trail, compare_bound, &by_path);
        bdpt_sample(bdpt, &joined, rng_double(&rng) * FILM, rng_double(&rng) * FILM, BOTH_WAYS, NULL, &rng, compare_bound, &by_both);
    }
    printf("    samples are worth at most %.15g and %.15g times the threshold, where %d and %d had been worth more\n", by_path.most, by_both.most, by_path.above,
           by_both.above);
    CHECK(by_path.above > 100 && by_both.above > 100 && by_path.most < 1 + 1e-9 && by_both.most < 1 + 1e-9);
    CHECK(by_path.most > 1 - 1e-9 && by_both.most > 1 - 1e-9);
    bdpt_free(bdpt);
    free(trail);
}

/* The integrand divided at thresholds that have nothing to do with the picture: both parts make up the whole. */
static void test_divided(void)
{
    static Pixel film[FILM * FILM];
    static const char *const file[] = { "scenes/cornell.obj", "test/scenes/lamps.obj" };
    for (int f = 0; f < 2; f++) {
        for (int i = 0; i < FILM * FILM; i++) film[i] = (Pixel){ .weight = 1, .threshold = 0.02f * (float)(1 + i % 7) };
        Scene scene;
        int depth = 6, n = (int)(100 * factor);
        if (!load(&scene, file[f])) continue;
        printf("%s divided\n", file[f]);
        Space whole = { .scene = &scene, .max_depth = depth, .direct = DIRECT_INCLUDED }, seen = whole, capped, rest;
        seen.film = film;
        capped = rest = seen;
        capped.part = CAPPED;
        rest.part = REST;
        rest.direct = DIRECT_EXCLUDED;
        test_values(&seen);
        test_bound(&capped);
        Sampler sampler = sampler_for(&scene, ~0u);
        uint64_t bootstrap = (uint64_t)(20000 * factor), chains = (uint64_t)(1000 * factor);
        Group path = traced_group(&whole, n), part = traced_group(&capped, n), chain = chain_group(&rest, &sampler, bootstrap, chains, 60, splat);
        Group faulty = chain_group(&rest, &sampler, bootstrap, chains, 60, splat_whole), both = sum(&part, &chain), wrong = sum(&part, &faulty);
        agree("path, capped + rest", &path, &both, BY_TILES);
        disagree("the chains record all of f", &path, &wrong, BY_TILES);
        disagree("the rest left out", &path, &part, BY_TILES);
        scene_free(&scene);
    }
}

/* Lamps seen through glass and in it, capped at thresholds far below their radiance: what run_spread hands on makes up for what is cut off. */
typedef struct { Render *render; Rng *rng; double factor; int spread; Rgb own; } Spreading;

static void spread(void *context, const Candidate *c)
{
    Spreading *s = context;
    if (c->reach != REACH_SEEN) return;
    s->own = along(s->own, c->share, c->rgb);
    if (!(c->share < 1)) return;
    Candidate changed = *c;
    changed.rgb = scale(s->factor, c->rgb);
    CHECK(run_spread(s->render, &changed, 1, s->rng));
    s->spread++;
}

/* handed 0: the integrand is whole, and nothing is spread; 1: as it ought to be; else a fault: so many times what was cut off is handed on */
static Group spread_group(const Scene *scene, int depth, int per_pixel, double handed)
{
    Group g = { .runs = RUNS };
    const Settings settings = { .integrator = INTEGRATOR_MLT, .direct = LIGHT_APART, .max_depth = depth, .strategies = ~0u, .seed = seed };
    for (int i = 0; i < RUNS; i++) {
        Rng rng = rng_new(seed, ((uint64_t)i + 1) << (handed > 0 ? 35 : 45));
        Render *r = render_new(scene, &settings);
        if (!CHECK(r != NULL)) return g;
        Spreading s = { .render = r, .rng = &rng, .factor = handed };
        for (int j = 0; j < FILM * FILM; j++) {
            r->film[j].threshold = 0.05f * (float)(1 + j % 7);
            r->film[j].weight = 1.0f / (float)(1 + j % 5);
        }
        r->tau = 2;                                /* the picture is half the threshold: more chains */
        if (handed > 0) run_divide(r);
        r->direct_space.direct = DIRECT_INCLUDED;
        r->direct_space.seen = 1;
        for (int n = 0; n < per_pixel * FILM * FILM; n++) {
            uint32_t x = (uint32_t)n % FILM, y = (uint32_t)n / FILM % FILM;
            const Numbers numbers = numbers_random(&rng);
            s.own = vec3(0, 0, 0);
            path_trace(&r->direct_space, x, y, &numbers, &rng, r->trail, spread, &s);
            add_pixel(g.value[i], x, y, s.own, 1.0 / (per_pixel * FILM * FILM));
        }
        for (uint32_t y = 0; y < FILM; y++)
            for (uint32_t x = 0; x < FILM; x++) {
                const double *light = r->passes.light + 3 * (y * FILM + x);
                add_pixel(g.value[i], x, y, vec3(light[0], light[1], light[2]), 1.0 / (per_pixel * FILM * FILM));
            }
        CHECK(handed > 0 ? s.spread > 100 : s.spread == 0);
        for (size_t j = 0; j < r->pixels; j++) CHECK(r->passes.direct[j] == 0);    /* what is spread may be an outlier: it must not be taken for sure */
        CHECK(render_stats(r).bad_samples == 0);
        render_free(r);
    }
    return g;
}

static void test_spread(void)
{
    Scene scene;
    int depth = 8, n = (int)(120 * factor);
    if (!load(&scene, "test/scenes/direct.obj")) return;
    printf("test/scenes/direct.obj, lamps seen by way of glass spread over the film\n");
    Group path = spread_group(&scene, depth, 4 * n, 0), both = spread_group(&scene, depth, n, 1), much = spread_group(&scene, depth, n, 1.5);
    agree("path, capped + spread", &path, &both, BY_TILES);
    disagree("half as much again handed on than was cut off", &path, &much, BY_TILES);
    scene_free(&scene);
}

/* Passes of independent samples as a run has them, and what they have met and left to the chains, as their seeds (run_meet): together they make up the
 * whole, however often each pixel is sampled. But its own samples must not settle that. */
typedef enum { NO_FAULT, TWICE_LEFT, OWN_SAMPLES } MetFault;

/* As in run_share_out, but far more uneven: where a pixel, or the one so many further on, has been dark so far, there will be few samples. */
static void uneven(Render *r, double dark, uint32_t further)
{
    Passes *p = &r->passes;
    for (uint32_t i = 0; i < FILM * FILM; i++) {
        const double *other = p->sum + 3 * ((i + further) % (FILM * FILM));
        p->often[i] = other[0] + other[1] + other[2] < dark ? 0.25f : 2.5f;
    }
    run_settle(r);
}

static double mean_sum(const Render *r)
{
    double mean = 0;
    for (int i = 0; i < 3 * FILM * FILM; i++) mean += r->passes.sum[i] / (FILM * FILM);
    return mean;
}

/* What a run decides. */
typedef struct { bool bidirectional; BentWalks bent; float threshold; bool noisy; BentWalks seeds_bent; bool catches, direct_joined; } Division;

static Group met_group(const Scene *scene, int depth, int per_pixel, const Division *division, MetFault fault)
{
    enum { PASSES = 4, SEEDED = 400, STEPS = 100 };                    /* passes of a run, of which each mean has many; chains of them all, steps of a chain */
    Group g = { .runs = RUNS };
    int parts = per_pixel / PASSES;
    double hits = 0, dark = 0, from_bootstrap = 0;
    for (int i = 0; i < RUNS; i++)
        for (int part = 0; part < parts; part++) {
            const Settings settings = { .integrator = INTEGRATOR_MLT, .direct = LIGHT_APART, .max_depth = depth, .strategies = ~0u,
                                        .seed = seed * 100000 + 1000 + (uint64_t)(i * parts + part) };
            Rng rng = rng_new(settings.seed, (uint64_t)1 << 36);       /* numbers that no other group has */
            Render *r = render_new(scene, &settings);
            Image *image = image_new(FILM, FILM);
            Bootstrap boot;
            double met, variance;
            if (!CHECK(r && image)) return g;
            for (int j = 0; j < FILM * FILM; j++) {
                r->film[j].threshold = division->threshold * (float)(1 + j % 7);
                r->film[j].weight = 1.0f / (float)(1 + j % 5);
            }
            r->tau = 1e-9;                         /* what is REACH_SEEN is not cut */
            r->bidirectional = division->bidirectional;
            r->bent = division->bent;
            r->catches = division->catches;
            r->direct_joined = division->direct_joined;
            r->pilot = false;
            run_divide(r);
            while (r->passes.rows < PASSES * FILM - 1) {
                CHECK(run_sample_row(r));
                if (r->passes.rows != 2 * FILM) continue;
                if (dark > 0) uneven(r, dark, fault == OWN_SAMPLES ? 0 : 1);
                else dark = 0.7 * mean_sum(r);     /* of the first alone: no pixel is to be judged by itself */
            }
            render_image(r, image);
            for (uint32_t y = 0; y < FILM; y++)
                for (uint32_t x = 0; x < FILM; x++)
                    add_pixel(g.value[i], x, y, from_float(image->rgb + 3 * (y * FILM + x)), 1.0 / (FILM * FILM * parts));
            if (fault == TWICE_LEFT) r->met.sum *= 2;
            met = run_met(r, &variance);
            uint64_t bootstrap = division->bidirectional ? 0 : (uint64_t)(4000 * factor / parts);
            CHECK(bootstrap_new(&boot, bootstrap, settings.seed, (uint64_t)2 << 36));
            boot.bent = division->seeds_bent;
            bootstrap_sample(&boot, &r->chain_space, r->bdpt, bootstrap);
            from_bootstrap += boot.b / (boot.b + met);
            Group chain = { .runs = RUNS };
            ChainCount count = { 0 };
            double b = boot.b + met, offset = rng_double(&rng), chains = ceil(SEEDED * factor / parts);
            for (uint64_t c = 0; c < (uint64_t)chains && b > 0; c++) {
                double u = even(offset, c, 0) * b;
                if (u >= boot.b) run_met_seed(r, (u - boot.b) / met, r->x);
                else if (!bootstrap_seed(&boot, &r->chain_space, r->bdpt, u / boot.b, r->x)) continue;
                chain_run(&r->chain_space, &r->sampler, r->x, r->y, STEPS, &rng, splat, chain.value[0], &count);
            }
            for (int v = 0; v < VALUES; v++) g.value[i][v] += chain.value[0][v] * b / (chains * STEPS * parts) * (fault == TWICE_LEFT && division->seeds_bent ? 2 : 1);
            hits += (double)r->met.hits;
            CHECK(count.bad == 0);
            bootstrap_free(&boot);
            image_free(image);
            render_free(r);
        }
    CHECK(hits > 100 * RUNS || from_bootstrap > 0.9 * RUNS * parts);
    return g;
}

/* A basin full of water, a lamp over it: every path to its floor is L S+ D S+ E. */
static const char basin_obj[] =
    "mtllib basin.mtl\n"
    "v -1 -1 -1\nv 1 -1 -1\nv 1 -1 1\nv -1 -1 1\nv -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\n"
    "v -0.6 0.9 -0.6\nv 0.6 0.9 -0.6\nv 0.6 0.9 0.6\nv -0.6 0.9 0.6\n"
    "usemtl wall\nf 4 3 2 1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    "usemtl water\nf 8 7 6 5\n"
    "usemtl light\nf 9 10 11 12\n";
static const char basin_mtl[] = "newmtl wall\nKd 0.6 0.6 0.6\nnewmtl water\nillum 4\nNi 1.33\nnewmtl light\nKd 0 0 0\nKe 5 4 3\n";
/* The same box under a thin pane, seen from below it. */
static const char pane_obj[] =
    "mtllib basin.mtl\n"
    "v -1 -1 -1\nv 1 -1 -1\nv 1 -1 1\nv -1 -1 1\nv -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\n"
    "v -0.6 0.9 -0.6\nv 0.6 0.9 -0.6\nv 0.6 0.9 0.6\nv -0.6 0.9 0.6\nv -1 -0.002 -1\nv 1 -0.002 -1\nv 1 -0.002 1\nv -1 -0.002 1\n"
    "usemtl wall\nf 4 3 2 1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    "usemtl water\nf 8 7 6 5\nf 13 14 15 16\n"
    "usemtl light\nf 9 10 11 12\n";
static const char pane_cam[] = "eye 0 -0.3 0.9\nlook 0 -0.8 0\nfov 70\n";
static const char basin_cam[] = "eye 0 0.7 1.5\nlook 0 -0.6 0\nfov 60\n";

/* The same two accounts where walks are bent. */
static void test_bent_values(Space space, bool bidirectional, BentWalks bent)
{
    static Pixel film[FILM * FILM];
    for (int i = 0; i < FILM * FILM; i++) film[i] = (Pixel){ .weight = 1, .threshold = 1 };
    space.film = film;
    space.part = CAPPED;
    space.bent = bent;
    space.bidirectional = bidirectional;
    Values v = { .bdpt = bdpt_new(), .space = &space, .path = calloc(1, sizeof(Path)) };
    Rng rng = rng_new(seed, 97);
    if (!bidirectional) v.trail = calloc(1, sizeof(Path));
    for (int i = 0; i < 5000; i++) {
        const Numbers numbers = numbers_random(&rng);
        if (bidirectional) bdpt_sample(v.bdpt, &space, rng_double(&rng) * FILM, rng_double(&rng) * FILM, BOTH_WAYS, NULL, &rng, compare_share, &v);
        else path_trace(&space, (uint32_t)i % FILM, (uint32_t)i / FILM % FILM, &numbers, &rng, v.trail, compare_share, &v);
    }
    printf("    share of a bent walk's path, told by the sampler and by the path: %d paths, %.2g apart\n", v.n, v.worst);
    CHECK(v.n > 1000 && v.worst < 1e-9);
    bdpt_free(v.bdpt);
    free(v.path);
    free(v.trail);
}

/* A way of drawing samples by hand, and what may be wrong with it. */
typedef struct {
    const Space *space;
    bool from_light, unjoined;     /* walks from the light that are bent to the lens; what can be joined nowhere alone */
    FirstGlass glass;
    double most;                   /* that a find counts; INFINITY, or a fault */
    bool in_full;                  /* a fault: each of both ways at the first glass counts as if it were the only one */
    const Space *taken_for;        /* a fault: the densities are those of another space; or NULL */
    Bdpt *bdpt;
    Path *path;
    double *value;
} Draw;

static void add_candidate(void *context, const Candidate *c)
{
    const Draw *d = context;
    double times = 1;
    if (d->unjoined && c->reach != REACH_UNJOINED) return;
    if (d->in_full && bdpt_path(d->bdpt, d->space, c->n_light, c->n_lens, d->path)) times = 1 / path_first_chance(d->path->v[d->path->k - 1].s.q);
    if (d->taken_for && bdpt_path(d->bdpt, d->taken_for, c->n_light, c->n_lens, d->path)) times = path_bidirectional_value(d->taken_for, d->path) / luminance(c->rgb);
    add_pixel(d->value, c->pixel % FILM, c->pixel / FILM, scale(times, c->rgb), 1);
}

static void add_caught(void *context, double times)
{
    const Draw *d = context;
    const Path *x = d->path;
    const Space *space = d->taken_for ? d->taken_for : d->space;
    if (path_reach(x) == REACH_UNJOINED) add_pixel(d->value, x->pixel % FILM, x->pixel / FILM, scale(fmin(times, d->most) / bend_density(space, x), x->colour), 1);
}

static Group drawn_group(Draw d, uint64_t stream, int n)
{
    Group g = { .runs = RUNS };
    d.bdpt = bdpt_new();
    d.path = calloc(1, sizeof *d.path);
    if (!CHECK(d.bdpt && d.path)) return g;
    for (int i = 0; i < RUNS; i++) {
        Rng rng = rng_new(seed, (stream << 40) + (uint64_t)i);
        d.value = g.value[i];
        for (int j = 0; j < n; j++) {
            if (d.from_light) bend_from_light(d.space, d.path, &rng, add_caught, &d);
            else bdpt_sample(d.bdpt, d.space, FILM * rng_double(&rng), FILM * rng_double(&rng), d.glass, NULL, &rng, add_candidate, &d);
        }
        for (int v = 0; v < VALUES; v++) g.value[i][v] /= n;
    }
    bdpt_free(d.bdpt);
    free(d.path);
    return g;
}

static void test_caught(void)
{
    Scene scene;
    folder_write_text("basin.obj", basin_obj);
    folder_write_text("basin.mtl", basin_mtl);
    folder_write_text("basin.cam", basin_cam);
    if (!load(&scene, folder_path("basin.obj"))) return;
    printf("the floor under water, walks from the light bent to the lens\n");
    Space whole = { .scene = &scene, .max_depth = 7, .direct = DIRECT_INCLUDED, .bent = BENT_ALL };
    int n = (int)(20000 * factor);
    Draw by_samples = { .space = &whole, .unjoined = true, .glass = BOTH_WAYS }, from_light = { .space = &whole, .from_light = true, .most = INFINITY }, once = from_light;
    once.most = 1;
    Group samples = drawn_group(by_samples, 4, n), caught = drawn_group(from_light, 3, 4 * n), much = drawn_group(once, 3, 4 * n);
    agree("bidirectional samples, walks from the light", &samples, &caught, BY_TILES);
    disagree("guesses until the way is found again are not counted", &samples, &much, BY_TILES);
    scene_free(&scene);
}

static void test_both_ways(void)
{
    Scene scene;
    folder_write_text("basin.obj", basin_obj);
    folder_write_text("basin.mtl", "newmtl wall\nKd 0.6 0.6 0.6\nnewmtl water\nillum 4\nNi 3\nnewmtl light\nKd 0 0 0\nKe 5 4 3\n");
    folder_write_text("basin.cam", basin_cam);
    if (!load(&scene, folder_path("basin.obj"))) return;
    printf("the floor under what reflects much, both ways there\n");
    int n = (int)(20000 * factor);
    for (BentWalks bent = BENT_NONE; bent <= BENT_ALL; bent += BENT_ALL) {
        Space whole = { .scene = &scene, .max_depth = 7, .direct = DIRECT_INCLUDED, .bent = bent };
        Draw one_way = { .space = &whole, .glass = ONE_WAY }, both_ways = { .space = &whole, .glass = BOTH_WAYS }, in_full = both_ways;
        in_full.in_full = true;
        Group one = drawn_group(one_way, 6, n), both = drawn_group(both_ways, 5, n), full = drawn_group(in_full, 5, n);
        agree(bent ? "bidirectional, one way, both ways, walks bent" : "bidirectional, one way, both ways", &one, &both, BY_TILES);
        disagree("each of both ways counts in full", &one, &full, BY_TILES);
    }
    scene_free(&scene);
}

/* A room under a roof with a hole, and a lamp high above, most of whose light misses it. */
static const char hole_obj[] =
    "mtllib hole.mtl\n"
    "v -1 -1 -1\nv 1 -1 -1\nv 1 -1 1\nv -1 -1 1\nv -1 1 -1\nv 1 1 -1\nv 1 1 1\nv -1 1 1\n"
    "v -0.2 1 -0.2\nv 0.2 1 -0.2\nv 0.2 1 0.2\nv -0.2 1 0.2\n"
    "v 0.5 4 -0.2\nv 0.9 4 -0.2\nv 0.9 4 0.2\nv 0.5 4 0.2\n"
    "usemtl wall\nf 4 3 2 1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\nf 5 6 10 9\nf 6 7 11 10\nf 7 8 12 11\nf 8 5 9 12\n"
    "usemtl light\nf 13 14 15 16\n";
static const char hole_mtl[] = "newmtl wall\nKd 0.6 0.5 0.4\nnewmtl light\nKd 0 0 0\nKe 80 70 60\n";
static const char hole_cam[] = "eye 0 0 0.9\nlook 0 -0.5 -1\nfov 80\n";

typedef struct { Emission *emission; const Scene *scene; const Space *space; Bdpt *bdpt; Path *path; } Telling;
static void tell_emission(void *context, const Candidate *c)
{
    const Telling *t = context;
    if (reach_is_direct(c->reach) || !bdpt_path(t->bdpt, t->space, c->n_light, c->n_lens, t->path)) return;
    const Vertex *lamp = &t->path->v[0];
    emission_see(t->emission, (uint32_t)(lamp->point.surface.material - t->scene->mesh.material), lamp->to_lens, dot(lamp->to_lens, lamp->point.surface.ng));
}

static void learn_emission(Emission *e, const Space *space)
{
    Telling t = { e, space->scene, space, bdpt_new(), calloc(1, sizeof(Path)) };
    Rng rng = rng_new(seed, 98);
    for (int i = 0; i < 20000; i++) bdpt_sample(t.bdpt, space, FILM * rng_double(&rng), FILM * rng_double(&rng), BOTH_WAYS, NULL, &rng, tell_emission, &t);
    emission_learn(e);
    bdpt_free(t.bdpt);
    free(t.path);
}

/* Light subpaths that leave their lamp as was learned: the same picture, by samples, by walks from the light that are bent to the lens, by chains. */
static void test_emission(void)
{
    Scene scene;
    int n = (int)(20000 * factor), depth = 6;
    folder_write_text("hole.obj", hole_obj);
    folder_write_text("hole.mtl", hole_mtl);
    folder_write_text("hole.cam", hole_cam);
    Emission *learned = calloc(1, sizeof *learned);
    if (!CHECK(learned)) return;
    if (load(&scene, folder_path("hole.obj"))) {
        printf("a room under a hole, directions of emission learned\n");
        Space whole = { .scene = &scene, .max_depth = depth, .direct = DIRECT_EXCLUDED }, guided = whole;
        learn_emission(learned, &whole);
        guided.emission = learned;
        CHECK(emission_active(learned));
        Draw plain = { .space = &whole, .glass = BOTH_WAYS }, by_learned = { .space = &guided, .glass = BOTH_WAYS }, unaware = by_learned;
        unaware.taken_for = &whole;
        Group a = drawn_group(plain, 8, n), b = drawn_group(by_learned, 9, n), wrong = drawn_group(unaware, 9, n);
        agree("bidirectional samples", &a, &b, BY_TILES);
        disagree("densities are those of the cosine law", &a, &wrong, BY_TILES);
        test_bent_values(guided, true, BENT_NONE);
        double by_cosine, by_light;
        moments(&a, TILES * TILES, &by_light, &by_cosine);
        moments(&b, TILES * TILES, &by_light, &by_light);
        printf("    variance, learned over cosine law: %.3f\n", by_light / by_cosine);
        CHECK(by_light < 0.7 * by_cosine);
        Effort effort = { 400, 100, 1000, 0 };
        Group path = render_group(&scene, INTEGRATOR_PATH, LIGHT_APART, depth, effort), mlt = render_group(&scene, INTEGRATOR_MLT, LIGHT_APART, depth, effort);
        agree("path, mlt", &path, &mlt, BY_TILES);
        Settings s = { .integrator = INTEGRATOR_MLT, .direct = LIGHT_APART, .max_depth = depth, .strategies = ~0u, .seed = seed, .per_pixel = 1000 };
        Render *r = render_new(&scene, &s);
        CHECK(r && render_run(r, always, NULL) && r->chain_space.emission && emission_active(r->emission));
        render_free(r);
        scene_free(&scene);
    }
    folder_write_text("basin.obj", basin_obj);
    folder_write_text("basin.mtl", basin_mtl);
    folder_write_text("basin.cam", basin_cam);
    if (load(&scene, folder_path("basin.obj"))) {
        printf("the floor under water, directions of emission from a cone\n");
        Space whole = { .scene = &scene, .max_depth = 7, .direct = DIRECT_INCLUDED, .bent = BENT_ALL }, guided = whole;
        Rng rng = rng_new(seed, 99);
        memset(learned, 0, sizeof *learned);
        for (int i = 0; i < 1000; i++) {
            Vec3 w = normalize(vec3(0.3 + 0.1 * rng_double(&rng), -1, 0.2 * rng_double(&rng)));
            emission_see(learned, (uint32_t)(scene.mesh.triangle_material[scene.light[0]]), w, -w.y);
        }
        emission_learn(learned);
        guided.emission = learned;
        CHECK(emission_active(learned));
        Draw plain = { .space = &whole, .glass = BOTH_WAYS }, by_learned = { .space = &guided, .glass = BOTH_WAYS };
        Draw from_light = { .space = &whole, .from_light = true, .most = INFINITY }, so_learned = { .space = &guided, .from_light = true, .most = INFINITY }, unaware = so_learned;
        unaware.taken_for = &whole;
        Group a = drawn_group(plain, 10, n), b = drawn_group(by_learned, 11, n), c = drawn_group(from_light, 12, 4 * n), d = drawn_group(so_learned, 13, 4 * n), wrong = drawn_group(unaware, 13, 4 * n);
        agree("bidirectional samples, walks bent", &a, &b, BY_TILES);
        agree("walks from the light bent to the lens", &c, &d, BY_TILES);
        disagree("densities are those of the cosine law", &c, &wrong, BY_TILES);
        test_bent_values(guided, true, BENT_ALL);
        scene_free(&scene);
    }
    free(learned);
}

static void test_met(void)
{
    folder_write_text("basin.obj", basin_obj);
    folder_write_text("basin.mtl", basin_mtl);
    folder_write_text("basin.cam", basin_cam);
    folder_write_text("pane.obj", pane_obj);
    folder_write_text("pane.cam", pane_cam);
    const struct { const char *name, *file; int per_pixel; Division d; } list[] = {
        { "the floor under water, seeds from the path tracer", "basin.obj", 60, { .threshold = 0.05f } },
        { "the floor under water, seeds from the path tracer and from the light", "basin.obj", 60, { .threshold = 0.05f, .catches = true } },
        { "the floor under water, seeds from the path tracer, walks bent", "basin.obj", 60, { .bent = BENT_ALL, .threshold = 0.02f } },
        { "the floor under water, seeds from the path tracer, walks bent where nothing can be joined", "basin.obj", 60, { .bent = BENT_UNJOINED, .threshold = 0.02f } },
        { "the floor under water, all seeds from bidirectional samples", "basin.obj", 60, { .bidirectional = true, .threshold = 0.05f } },
        { "the floor under water, all seeds from bidirectional samples, walks bent", "basin.obj", 60, { .bidirectional = true, .bent = BENT_ALL, .threshold = 0.02f } },
        { "the floor under water, all seeds from bidirectional samples, walks bent where nothing can be joined, and from the light", "basin.obj", 60,
          { .bidirectional = true, .bent = BENT_UNJOINED, .threshold = 0.02f, .catches = true } },
        { "scenes/cornell.obj, all seeds from bidirectional samples", "scenes/cornell.obj", 120, { .bidirectional = true, .threshold = 0.005f, .noisy = true } },
        { "scenes/cornell.obj, all seeds and direct light from bidirectional samples", "scenes/cornell.obj", 120, { .bidirectional = true, .threshold = 0.005f, .direct_joined = true } },
        { "under a pane, seeds from a bootstrap whose walks are bent", "pane.obj", 60, { .threshold = 0.02f, .seeds_bent = BENT_ALL } },
    };
    for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
        Scene scene;
        int depth = 7, n = (int)(list[i].per_pixel * factor);
        if (!load(&scene, strchr(list[i].file, '/') ? list[i].file : folder_path(list[i].file))) continue;     /* its own are in its folder */
        printf("%s\n", list[i].name);
        Space whole = { .scene = &scene, .max_depth = depth, .direct = DIRECT_INCLUDED };
        const Division *d = &list[i].d;
        if (d->bent) test_bent_values(whole, d->bidirectional, d->bent);
        Group path = traced_group(&whole, 4 * n), both = met_group(&scene, depth, n, d, NO_FAULT), much = met_group(&scene, depth, n, d, TWICE_LEFT);
        agree("path, capped + chains from what was met", &path, &both, BY_TILES);
        disagree("twice as much is left to the chains", &path, &much, BY_TILES);
        if (d->noisy) {
            Group own = met_group(&scene, depth, n, d, OWN_SAMPLES);
            disagree("a pixel's own samples settle how many it has", &path, &own, BY_TILES);
        }
        scene_free(&scene);
    }
}

/* ---- colours of which nothing is left ---- */

/* A red lamp over a green floor, both behind glass: paths from one to the other carry nothing, and are no samples that failed. */
static const char primaries_obj[] =
    "mtllib primaries.mtl\n"
    "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv -1 2 -1\nv 1 2 -1\nv 1 2 1\nv -1 2 1\n"
    "v -0.5 1.9 -0.3\nv -0.1 1.9 -0.3\nv -0.1 1.9 0.3\nv -0.5 1.9 0.3\nv 0.1 1.9 -0.3\nv 0.5 1.9 -0.3\nv 0.5 1.9 0.3\nv 0.1 1.9 0.3\n"
    "v -0.9 1.5 -0.9\nv 0.9 1.5 -0.9\nv 0.9 1.5 0.9\nv -0.9 1.5 0.9\nv -0.9 1.6 -0.9\nv 0.9 1.6 -0.9\nv 0.9 1.6 0.9\nv -0.9 1.6 0.9\n"
    "usemtl green\nf 1 4 3 2\n"
    "usemtl white\nf 5 6 7 8\nf 1 2 6 5\nf 1 5 8 4\nf 2 3 7 6\nf 4 8 7 3\n"
    "usemtl red\nf 9 10 11 12\n"
    "usemtl lamp\nf 13 14 15 16\n"
    "usemtl glass\nf 17 18 19 20\nf 21 24 23 22\nf 17 21 22 18\nf 18 22 23 19\nf 19 23 24 20\nf 20 24 21 17\n";
static const char primaries_mtl[] =
    "newmtl green\nKd 0 0.8 0\nnewmtl white\nKd 0.5 0.5 0.5\nnewmtl red\nKd 0 0 0\nKe 8 0 0\nnewmtl lamp\nKd 0 0 0\nKe 4 4 4\nnewmtl glass\nillum 4\nNi 1.5\n";
static const char primaries_cam[] = "eye 0 0.7 0.95\nlook 0 0.5 0\nfov 80\n";

static void test_primaries(void)
{
    Scene scene;
    folder_write_text("primaries.obj", primaries_obj);
    folder_write_text("primaries.mtl", primaries_mtl);
    folder_write_text("primaries.cam", primaries_cam);
    if (!load(&scene, folder_path("primaries.obj"))) return;
    static const Effort effort = { 96, 96, 192, 6000 };
    Group bdpt = render_group(&scene, INTEGRATOR_BDPT, LIGHT_APART, 6, effort);
    Group chains = render_group(&scene, INTEGRATOR_MLT, LIGHT_CHAIN, 6, effort), divided = render_group(&scene, INTEGRATOR_MLT, LIGHT_APART, 6, effort);
    printf("primaries.obj\n");
    agree("bdpt, mlt with --direct chain", &bdpt, &chains, BY_TILES);
    agree("bdpt, mlt", &bdpt, &divided, BY_TILES);
    scene_free(&scene);
}

/* ---- stopped at any moment ---- */

/* What a run has done when it is stopped. */
typedef enum { NO_CHAIN_YET, ONE_PILOT, DIVIDED, A_ROUND, STOPS } Stop;
static bool has_come(const Render *r, Stop moment)
{
    switch (moment) {
    case NO_CHAIN_YET: return true;
    case ONE_PILOT: return r->pilot && r->early;
    case DIVIDED: return !r->pilot;
    default: return !r->pilot && r->steps_sum > 0;
    }
}
static bool until(void *context, const Render *r) { return !has_come(r, *(const Stop *)context); }

/* The picture of a run that is stopped lacks no light, whatever it had come to; and no merge takes what only pilots have made for a result. */
static void test_stopped(void)
{
    static const char *const name[] = { "before a chain", "after a pilot", "the integrand just divided", "a round is done" };
    enum { TIMES = 60, OFTEN = 1200 /* where a run is short */, DEPTH = 6 };
    Scene scene;
    Image *image = image_new(FILM, FILM);
    if (!CHECK(image) || !load(&scene, "scenes/door.obj")) return;
    static const Effort effort = { 0, 400, 0, 0 };
    Group bdpt = render_group(&scene, INTEGRATOR_BDPT, LIGHT_APART, DEPTH, effort);
    double expected, of_expected;
    moments(&bdpt, TILES * TILES, &expected, &of_expected);
    printf("stopped, door: the picture's mean over that of bidirectional samples\n");
    for (Stop stop = 0; stop < STOPS; stop++) {
        double value[OFTEN], mean, variance;
        int times = stop == NO_CHAIN_YET ? OFTEN : TIMES;
        for (int i = 0; i < times; i++) {
            Settings s = { .direct = LIGHT_APART, .max_depth = DEPTH, .strategies = ~0u, .seed = seed * 1000000 + 500000 + (uint64_t)i, .per_pixel = 800 };
            Render *r = render_new(&scene, &s);
            if (!CHECK(r && render_run(r, until, &stop))) return;
            render_image(r, image);
            if (stop == DIVIDED) CHECK(memcmp(image->rgb, r->early->rgb, 3 * r->pixels * sizeof(float)) == 0);     /* capped samples alone are none */
            value[i] = 0;
            for (size_t j = 0; j < FILM * FILM; j++) value[i] += luminance(from_float(image->rgb + 3 * j)) / (FILM * FILM);
            if (i == 0) {
                Report report = { .warnings = NULL };
                const char *state = folder_path("stopped.state");
                CHECK(render_save(r, state, &report));
                Render *merged = render_merge(&state, 1, &report);
                CHECK((merged != NULL) == (stop == A_ROUND));
                render_merged_free(merged);
            }
            render_free(r);
        }
        mean_and_variance(value, 1, times, &mean, &variance);
        double error = sqrt(variance + of_expected), t, chance = welch_chance(expected, of_expected, bdpt.runs, mean, variance, times, &t);
        printf("    %-28s %.3f +- %.3f\n", name[stop], mean / expected, error / expected);
        CHECK(chance > 1e-6 && error < 0.03 * expected);
    }
    image_free(image);
    scene_free(&scene);
}

/* ---- how far chains get ---- */

/* What a run says of rounds that have, in a share of the pixels, left the same in both halves of their chains, and in the others what knows nothing of it. */
static double persistence_of(const Scene *scene, double share, uint64_t stream)
{
    enum { ROUNDS = 100, STEPS = 1000 };
    const Settings settings = { .integrator = INTEGRATOR_MLT, .direct = LIGHT_CHAIN, .max_depth = 8, .strategies = ~0u };
    Render *r = render_new(scene, &settings);
    Rng rng = rng_new(seed, stream);
    if (!CHECK(r != NULL)) return NAN;
    r->pilot = false;
    for (int round = 0; round < ROUNDS; round++) {
        for (size_t i = 0; i < r->pixels; i++) {
            double first = -log(1 - rng_double(&rng)), second = (double)i < share * (double)r->pixels ? first : -log(1 - rng_double(&rng));
            r->film[i].halves = (float)(first - second);
            for (int c = 0; c < 3; c++) r->film[i].sum[c] = first + second;
        }
        r->round.steps = STEPS;
        r->round.b = 1;
        run_close_chains(r);
    }
    run_learn(r);
    double persistence = r->persistence;
    render_free(r);
    return persistence;
}

/* In the pixels that are alike the variance of the sum is 4, of the difference 0; in the others both are 2. And chains do tell: in a few steps they do not
 * get far, in thirty thousand all over the film. */
static void test_persistence(void)
{
    Scene scene;
    if (!load(&scene, "scenes/cornell.obj")) return;
    CHECK_NEAR(persistence_of(&scene, 0, 1), 0, 0.05);
    CHECK_NEAR(persistence_of(&scene, 0.5, 2), 2.0 / 3, 0.05);
    CHECK_NEAR(persistence_of(&scene, 1, 3), 1, 1e-6);
    double persistence[2];
    for (int longer = 0; longer < 2; longer++) {
        Settings s = { .direct = LIGHT_NONE, .max_depth = 8, .strategies = ~0u, .seed = seed, .per_pixel = 2000, .chains = longer ? 16 : 51200 };
        Render *r = render_new(&scene, &s);
        if (!CHECK(r && render_run(r, always, NULL))) return;
        persistence[longer] = r->persistence;
        render_free(r);
    }
    printf("persistence, cornell: chains of 10 steps %.2f, of 32000 %.2f\n", persistence[0], persistence[1]);
    CHECK(persistence[0] > persistence[1] + 0.2);
    scene_free(&scene);
}

/* ---- the furnace ---- */

static void test_furnace(void)
{
    Scene scene;
    static const char *const name[] = { "mlt", "bdpt", "path" };
    static const Effort some = { 60, 20, 100, 4000 }, much = { 300, 100, 200, 25000 };
    static const struct { int depth; const Effort *effort; } list[] = { { 1, &some }, { 2, &some }, { 3, &some }, { 5, &much }, { 10, &some } };
    if (!load(&scene, "scenes/furnace.obj")) return;
    printf("furnace: every pixel is 1 + 1/2 + .. + 1/2^(K-1)\n");
    for (size_t d = 0; d < sizeof list / sizeof list[0]; d++) {
        double expected = 2 * (1 - ldexp(1, -list[d].depth));
        for (int integrator = INTEGRATOR_MLT; integrator <= INTEGRATOR_PATH; integrator++) {
            Group g = render_group(&scene, (Integrator)integrator, LIGHT_APART, list[d].depth, *list[d].effort);
            Group exact = { .runs = RUNS }, longer = exact, scaled = g;
            for (int i = 0; i < RUNS; i++)
                for (int v = 0; v < VALUES; v++) {
                    exact.value[i][v] = expected;
                    longer.value[i][v] = expected + ldexp(1, -list[d].depth);
                    scaled.value[i][v] *= 1.02;
                }
            double mean, variance;
            int worst;
            moments(&g, TILES * TILES, &mean, &variance);
            double chance = least_chance(&g, &exact, BY_TILES, &worst);
            printf("    K = %2d, %-4s %.5f +- %.5f, expected %.5f, least chance %.1g\n", list[d].depth, name[integrator], mean, sqrt(variance), expected, chance);
            CHECK(chance > CHANCE);
            if (list[d].effort == &some) continue;
            /* the others need a long run for an error well below 0.1 % */
            if (integrator == INTEGRATOR_PATH || factor >= 20) CHECK_NEAR(mean, expected, 0.001 * expected);
            disagree("b too large by 2 %", &exact, &scaled, AS_A_WHOLE);
            disagree("paths one edge longer", &longer, &g, AS_A_WHOLE);
        }
    }
    scene_free(&scene);
}

/* What a bootstrap says of the classes of paths is light, whatever weight w of the two-stage target the pixels have. */
static void test_found(void)
{
    Scene scene;
    if (!load(&scene, "scenes/caustic.obj")) return;
    size_t pixels = (size_t)scene.camera.width * scene.camera.height;
    Pixel *film = calloc(pixels, sizeof *film);
    Bdpt *bdpt = bdpt_new();
    Space space = { .scene = &scene, .max_depth = 8, .direct = DIRECT_INCLUDED };
    Bootstrap plain, weighted;
    for (size_t i = 0; i < pixels; i++) film[i].weight = (float)ldexp(1, (int)(i % 7));
    bool ok = bootstrap_run(&plain, &space, bdpt, 4000, seed, 0);
    space.film = film;
    if (CHECK(ok && bootstrap_run(&weighted, &space, bdpt, 4000, seed, 0))) {
        CHECK(weighted.b > 2 * plain.b);
        CHECK(plain.found[CLASS_CAUSTIC].hits > 0);
        for (int c = 0; c < CLASSES; c++) {
            CHECK(weighted.found[c].hits == plain.found[c].hits);
            CHECK_NEAR(weighted.found[c].weight, plain.found[c].weight, 1e-12 * plain.found[c].weight);
            CHECK_NEAR(weighted.found[c].square, plain.found[c].square, 1e-12 * plain.found[c].square);
        }
        bootstrap_free(&weighted);
    }
    bootstrap_free(&plain);
    bdpt_free(bdpt);
    free(film);
    scene_free(&scene);
}

/* ---- the estimated error ---- */

/* Variances of all values of the picture, summed, each over the square of the mean and a floor: as runs estimate it of themselves, with and without the
 * evenness of samples, and as it is between runs. */
static void test_estimated(void)
{
    enum { SIDE = 48, N = 3 * SIDE * SIDE, TIMES = 10 };
    static const struct { Integrator integrator; const char *name; double per_pixel; } list[] = { { INTEGRATOR_PATH, "path", 64 }, { INTEGRATOR_MLT, "mlt", 60 } };
    Scene scene;
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_size = true, .width = SIDE, .height = SIDE };
    if (!CHECK(scene_load(&scene, "scenes/cornell.obj", &camera, BVH_FAST, &report))) return;
    double (*value)[N] = calloc(TIMES, sizeof *value), *estimated = calloc(N, sizeof *estimated), *uneven = calloc(N, sizeof *uneven);
    Image *image = image_new(SIDE, SIDE);
    for (size_t k = 0; CHECK(value && estimated && uneven && image) && k < 2; k++) {
        memset(estimated, 0, N * sizeof *estimated);
        memset(uneven, 0, N * sizeof *uneven);
        for (int i = 0; i < TIMES; i++) {
            Settings s = { .integrator = list[k].integrator, .direct = LIGHT_APART, .max_depth = 8, .strategies = ~0u, .seed = seed * 1000 + (uint64_t)i,
                           .per_pixel = list[k].per_pixel };
            Render *r = render_new(&scene, &s);
            CHECK(r && render_run(r, always, NULL));
            render_image(r, image);
            for (int j = 0; j < N; j++) value[i][j] = (double)image->rgb[j];
            render_error_image(r, image);
            for (int j = 0; j < N; j++) estimated[j] += pow((double)image->rgb[j], 2) / TIMES;
            r->passes.evenness.mean = 0;
            render_error_image(r, image);
            for (int j = 0; j < N; j++) uneven[j] += pow((double)image->rgb[j], 2) / TIMES;
            render_free(r);
        }
        double mean = 0, sum = 0, sum_uneven = 0, sum_true = 0;
        for (int i = 0; i < TIMES; i++)
            for (int j = 0; j < N; j++) mean += value[i][j] / ((double)N * TIMES);
        for (int j = 0; j < N; j++) {
            double m, variance;
            mean_and_variance(&value[0][j], N, TIMES, &m, &variance);
            double inverse = 1 / (m * m + 0.01 * mean * mean);
            sum_true += TIMES * variance * inverse;    /* that of a mean is a TIMES-th */
            sum += estimated[j] * inverse;
            sum_uneven += uneven[j] * inverse;
        }
        printf("cornell, %s: estimated over true variance %.2f; %.2f if samples knew nothing of each other\n", list[k].name, sum / sum_true, sum_uneven / sum_true);
        CHECK(sum > 0.8 * sum_true && sum < 1.4 * sum_true);
        if (list[k].integrator == INTEGRATOR_PATH) CHECK(sum_uneven > 1.5 * sum_true);
    }
    image_free(image);
    free(value);
    free(estimated);
    free(uneven);
    scene_free(&scene);
}

int main(int argc, char **argv)
{
    if (argc > 1) factor = atof(argv[1]);
    if (argc > 2) seed = (uint64_t)atoi(argv[2]);
    test_scenes();
    test_precisely();
    test_divided();
    test_spread();
    test_caught();
    test_both_ways();
    test_emission();
    test_met();
    test_primaries();
    test_stopped();
    test_persistence();
    test_furnace();
    test_found();
    test_estimated();
    printf("%d comparisons\n", comparisons);
    CHECK(comparisons < COMPARISONS);
    return check_report();
}
