/* One long chain of all strategies: whether anything creeps in that short ones do not show.
 *
 *     drift [MUTATIONS [SCENE]]         1e9 in test/scenes/lens-dof.obj if not told otherwise; run from the project's root
 *
 * Every BLOCK steps whatever the state has cached is made anew from its points and modes, and must not have moved; nothing that the chain records may
 * fail to be finite; the weights add up to the steps; and the light on each tile of the film, b times the mean of what was recorded there, is what
 * independent bidirectional samples find. The unit of variance is the block. Direct light is with the chain, the image-plane weight is 1.
 * Planted at the end: one cached number off by 0.01 %, and a b that is too large by 5 %. */
#include "check.h"
#include "fresh.h"
#include "mlt.h"
#include "statistics.h"
#include <stdlib.h>

enum { BLOCK = 100000, TILES = 4, ALL = TILES * TILES, MAX_DEPTH = 16, GROUPS = 50 };
static const double false_alarm = 1e-6;            /* of the whole program */

typedef struct { const Space *space; double now[ALL + 1]; uint64_t not_finite; } Light;      /* luminance by tile, and of the film */
typedef struct { uint64_t n; double sum[ALL + 1], square[ALL + 1]; } Moments;

static void add_light(Light *light, double x, double y, double luminance)
{
    const Camera *camera = &light->space->scene->camera;
    int column = (int)(x * TILES / camera->width), row = (int)(y * TILES / camera->height);
    if (!isfinite(luminance) || !(luminance >= 0) || column < 0 || row < 0 || column >= TILES || row >= TILES) { light->not_finite++; return; }
    light->now[row * TILES + column] += luminance;
    light->now[ALL] += luminance;
}

/* What a step stands for is weight * luminance(f)/f*. */
static void record(void *context, const Path *x, double weight) { add_light(context, x->raster_x, x->raster_y, weight * luminance(x->colour) * x->share / x->chi); }

static void visit(void *context, const Candidate *c)
{
    const Light *light = context;
    uint32_t width = light->space->scene->camera.width;
    add_light(context, c->pixel % width + 0.5, c->pixel / width + 0.5, c->weight);
}

/* Adds what 'steps' steps or samples have left in light->now, a mean. */
static void close_block(Light *light, Moments *m, double steps)
{
    m->n++;
    for (int i = 0; i <= ALL; i++) {
        double mean = light->now[i] / steps;
        m->sum[i] += mean;
        m->square[i] += mean * mean;
        light->now[i] = 0;
    }
}

static double mean_of(const Moments *m, int i) { return m->sum[i] / (double)m->n; }
static double variance_of(const Moments *m, int i)
{
    return fmax(0, m->square[i] / (double)m->n - mean_of(m, i) * mean_of(m, i)) / (double)(m->n - 1);
}

int main(int argc, char **argv)
{
    double mutations = argc > 1 ? atof(argv[1]) : 1e9;
    const char *file = argc > 2 ? argv[2] : "test/scenes/lens-dof.obj";
    uint64_t blocks = (uint64_t)fmax(2, mutations / BLOCK), per_group = (uint64_t)fmax(4000, mutations / 100 / GROUPS);
    Report report = { .warnings = NULL };
    CameraSettings none = { .has_size = false };
    Scene scene;
    if (!CHECK(scene_load(&scene, file, &none, BVH_FAST, &report))) { printf("%s\n", report.error); return check_report(); }
    Space space = { .scene = &scene, .max_depth = MAX_DEPTH, .direct = DIRECT_INCLUDED };
    Sampler sampler = sampler_for(&scene, ~0u);
    Bdpt *bdpt = bdpt_new();
    Path *x = calloc(1, sizeof *x), *y = calloc(1, sizeof *y), *fresh = calloc(1, sizeof *fresh);
    Bootstrap boot = { .sum = NULL };
    Light light = { .space = &space };
    Moments sampled = { .n = 0 }, chain = sampled;
    if (!CHECK(bdpt && x && y && fresh && bootstrap_run(&boot, &space, bdpt, GROUPS * per_group, 1, 0) && bootstrap_seed(&boot, &space, bdpt, 0.5, x))) return check_report();

    /* samples other than those of b and the seed */
    Rng rng = rng_new(2, 0);
    for (int group = 0; group < GROUPS; group++) {
        for (uint64_t i = 0; i < per_group; i++) {
            double px = rng_double(&rng) * scene.camera.width, py = rng_double(&rng) * scene.camera.height;
            bdpt_sample(bdpt, &space, px, py, BOTH_WAYS, NULL, &rng, visit, &light);
        }
        close_block(&light, &sampled, (double)per_group);
    }

    double worst = 0, weights = 0;
    ChainCount count = { .steps = 0 };
    int longest = 0;
    for (uint64_t block = 0; block < blocks; block++) {
        chain_run(&space, &sampler, x, y, BLOCK, &rng, record, &light, &count);
        check_worse(&worst, fresh_difference(&space, x, fresh));
        if (x->k > longest) longest = x->k;
        check_worse(&weights, fabs(light.now[ALL] / BLOCK - 1));
        close_block(&light, &chain, BLOCK);
    }

    printf("%s: %.3g mutations, one chain; states looked at have up to %d edges; longest run of rejections %.0f\n", file, (double)count.steps, longest, (double)count.longest_rejection);
    for (int i = 0; i < MUTATIONS; i++)
        if (count.row[i].proposed) printf("    %-8s %.3g proposed, %.2f accepted\n", mutation_table[i].name, (double)count.row[i].proposed, (double)count.row[i].accepted / (double)count.row[i].proposed);
    printf("cached against from scratch, every %d steps: worst relative difference %.1e\n", BLOCK, worst);
    printf("ratios that were not a number: %.0f, recorded light that was not finite: %.0f\n", (double)count.bad, (double)light.not_finite);
    printf("weights of a block over its steps: off by %.1e at most\n", weights);
    CHECK(count.steps == blocks * BLOCK);
    CHECK(worst < 1e-6);
    CHECK(count.bad == 0);
    CHECK(light.not_finite == 0);
    CHECK(weights < 1e-9);
    x->v[0].inv_G *= 1.0001;
    CHECK(fresh_difference(&space, x, fresh) > 1e-6);

    /* b * mean recorded, tile by tile; b has an error of its own */
    double least = 1, b_error = boot.b_variance / (boot.b * boot.b);
    for (int i = 0; i <= ALL; i++) {
        double t, mean = boot.b * mean_of(&chain, i), variance = boot.b * boot.b * variance_of(&chain, i) + mean * mean * b_error;
        int runs = chain.n < GROUPS ? (int)chain.n : GROUPS;
        double chance = welch_chance(mean, variance, runs, mean_of(&sampled, i), variance_of(&sampled, i), GROUPS, &t);
        if (i < ALL) least = fmin(least, chance);
        else printf("mean luminance: b %.5f +- %.5f, times the mean recorded %.5f; of independent samples %.5f +- %.5f, chance %.2g\n", boot.b, sqrt(boot.b_variance), mean,
                    mean_of(&sampled, i), sqrt(variance_of(&sampled, i)), chance);
        CHECK(chance > false_alarm / (ALL + 1));
        if (i == ALL) CHECK(welch_chance(1.05 * mean, variance, runs, mean_of(&sampled, i), variance_of(&sampled, i), GROUPS, &t) < false_alarm / (ALL + 1));
    }
    double error = 0;
    for (int i = 0; i < ALL; i++) error = fmax(error, sqrt(variance_of(&chain, i)) / mean_of(&chain, i));
    printf("tiles: least chance %.2g of %d; the chain's own error of a tile is %.2g %% at most\n", least, ALL, 100 * error);
    bootstrap_free(&boot);
    bdpt_free(bdpt);
    free(x);
    free(y);
    free(fresh);
    scene_free(&scene);
    return check_report();
}
