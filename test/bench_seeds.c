/* Whether pictures of different seeds differ by no more than each says of itself: means over tiles of the film, their spread over seeds and the
 * variance that runs estimate. Reports only; asserts nothing.
 *
 *     bench_seeds [--seeds N] [--mutations N] [--integrator mlt | path | bdpt] SCENE.obj ...        32 seeds, 300 per pixel, 128x96 pixels
 *
 * Over seeds, (mean - mean of means)^2 over the estimated variance, summed, is chi-square of N - 1 degrees of freedom for each tile, if the estimate is
 * right and the means are normal. Printed: the spread over the estimate, all tiles together and the extremes; the chance of the most extreme tile among
 * so many, which where light comes in rare parcels is small for that reason too. */
#include "../run.h"
#include "statistics.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { ALL = TILES_ACROSS * TILES_ACROSS, MOST = 1000 };

static bool always(void *context, const Render *render) { (void)context; (void)render; return true; }

static int bench(const char *file, int seeds, double per_pixel, Integrator integrator)
{
    static double value[ALL][MOST], variance[ALL][MOST];
    Scene scene;
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_size = true, .width = 128, .height = 96 };
    uint32_t tiles = 0;
    if (!scene_load(&scene, file, &camera, BVH_BEST, &report)) return fprintf(stderr, "bench_seeds: %s\n", report.error), 1;
    for (int i = 0; i < seeds; i++) {
        Settings s = { .integrator = integrator, .max_depth = 64, .strategies = ~0u, .seed = 1 + (uint64_t)i, .per_pixel = per_pixel };
        Render *r = render_new(&scene, &s);
        TileLight light[ALL];
        if (!r || !render_run(r, always, NULL)) return fprintf(stderr, "bench_seeds: out of memory\n"), 1;
        tiles = run_tiles(r);
        run_tile_light(r, light);
        for (uint32_t t = 0; t < tiles; t++) {
            value[t][i] = light[t].mean;
            variance[t][i] = light[t].variance;
        }
        render_free(r);
    }
    double sum = 0, lowest = INFINITY, highest = 0, least = 1, n = 0;
    for (uint32_t t = 0; t < tiles; t++) {
        double mean, of_mean, estimated = 0;
        mean_and_variance(value[t], 1, seeds, &mean, &of_mean);
        for (int i = 0; i < seeds; i++) estimated += variance[t][i] / seeds;
        if (estimated == 0 && of_mean == 0) continue;          /* black, or the same light in every sample */
        double ratio = seeds * of_mean / estimated;
        n++;
        sum += ratio;
        lowest = fmin(lowest, ratio);
        highest = fmax(highest, ratio);
        least = fmin(least, erfc(fabs(chi_square_deviate(ratio * (seeds - 1), seeds - 1)) / sqrt(2)));
    }
    printf("%s: %.0f tiles, spread over estimate %.2f, from %.2f to %.2f; least chance %.2g, of one in so many %.2g\n", file, n, sum / n, lowest, highest, least,
           fmin(1, least * n));
    fflush(stdout);
    scene_free(&scene);
    return 0;
}

int main(int argc, char **argv)
{
    int seeds = 32, bad = 0, scenes = 0;
    double per_pixel = 300;
    Integrator integrator = INTEGRATOR_MLT;
    for (int i = 1; i < argc && !bad; i++) {
        if (argv[i][0] != '-') {
            bad = bench(argv[i], seeds, per_pixel, integrator);
            scenes++;
            continue;
        }
        const char *value = i + 1 < argc ? argv[i + 1] : "";
        if (!strcmp(argv[i], "--seeds")) seeds = atoi(value);
        else if (!strcmp(argv[i], "--mutations")) per_pixel = strtod(value, NULL);
        else if (!strcmp(argv[i], "--integrator") && !strcmp(value, "mlt")) integrator = INTEGRATOR_MLT;
        else if (!strcmp(argv[i], "--integrator") && !strcmp(value, "path")) integrator = INTEGRATOR_PATH;
        else if (!strcmp(argv[i], "--integrator") && !strcmp(value, "bdpt")) integrator = INTEGRATOR_BDPT;
        else seeds = 0;
        bad = seeds < 2 || seeds > MOST || !(per_pixel > 0);
        i++;
    }
    if (!bad && scenes > 0) return 0;
    fprintf(stderr, "usage: bench_seeds [--seeds N] [--mutations N] [--integrator mlt | path | bdpt] SCENE.obj ...\n");
    return 2;
}
