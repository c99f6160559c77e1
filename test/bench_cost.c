/* What a mutation costs: against the number of triangles, and against the length of paths; and what the tree costs.
 *
 *     bench_cost FOLDER [MOST_TRIANGLES [SECONDS]]
 *
 * A bumpy sphere of 10^2, 10^3 .. MOST_TRIANGLES (10^7) triangles in a room, with both trees; then an empty room of reflectance 0.99 for longer and
 * longer paths. All times are processor time; those of mutations are the median of SLICES pieces of SECONDS (1) in all, direct light included,
 * path space whole. Stops before the next size when it would not fit into the memory that is free. Some two minutes.
 * Writes FOLDER/cost-triangles.csv, cost-length.csv, cost-mutation.svg, cost-build.svg, cost-bytes.svg, cost-length.svg, and the CSV on standard
 * output too. Reports only. FOLDER/cost.obj and .mtl, the scene, are removed at the end. */
#include "mlt.h"
#include "svgplot.h"
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

enum { SIZES = 7, DEPTHS = 8, EFFORTS = 2, SETS = 2, ALL_SETS = 3, SLICES = 15, CHAIN = 512, PIECE = 256, STARTS = 10000 };
static const char *const effort_name[EFFORTS] = { "fast", "best" };
/* The last, only against length: the bidirectional mutation chooses the segment to delete uniformly, and weighs none. */
static const struct { const char *name; unsigned allowed; bool uniform; } set[ALL_SETS] = { { "bidir alone", 1, false }, { "all", ~0u, false }, { "bidir, uniform p_d2", 1, true } };

/* Of this process alone: other work on the machine takes less from it than from the clock on the wall. */
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void fail(const char *what)
{
    fprintf(stderr, "bench_cost: %s\n", what);
    exit(1);
}

static FILE *open_file(const char *folder, const char *name)
{
    char path[1024];
    FILE *f = snprintf(path, sizeof path, "%s/%s", folder, name) < (int)sizeof path ? fopen(path, "w") : NULL;
    if (!f) fail("cannot write to the folder");
    return f;
}

static void close_file(FILE *f)
{
    bool ok = !ferror(f);
    if (fclose(f) != 0 || !ok) fail("cannot write");
}

/* ---- scenes ---- */

/* A room with a lamp under its ceiling, and in it a sphere of about n triangles; no sphere for n = 0. */
static void write_scene(const char *folder, uint32_t n, double reflectance)
{
    FILE *f = open_file(folder, "cost.mtl");
    fprintf(f, "newmtl wall\nKd %g %g %g\nnewmtl lamp\nKd 0 0 0\nKe 10 10 10\n", reflectance, reflectance, reflectance);
    close_file(f);
    f = open_file(folder, "cost.obj");
    fputs("mtllib cost.mtl\n"
          "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n"
          "v -0.3 0.99 -0.3\nv 0.3 0.99 -0.3\nv 0.3 0.99 0.3\nv -0.3 0.99 0.3\n"
          "usemtl lamp\nf 9 10 11 12\n"
          "usemtl wall\nf 1 2 3 4\nf 8 7 6 5\nf 4 8 5 1\nf 2 6 7 3\nf 1 5 6 2\nf 3 7 8 4\n", f);
    int rows = n > 0 ? (int)(sqrt(n / 4.0 + 0.25) + 0.5) : 0, columns = 2 * rows, first = 13, pole = first + (rows - 1) * columns;
    for (int i = 1; i < rows; i++)
        for (int j = 0; j < columns; j++) {
            double theta = PI * i / rows, phi = PI * j / rows, r = 0.6 * (1 + 0.05 * sin(17 * theta) * cos(19 * phi) + 0.015 * sin(61 * theta + 53 * phi));
            fprintf(f, "v %.7g %.7g %.7g\n", r * sin(theta) * cos(phi), r * cos(theta) - 0.3, r * sin(theta) * sin(phi));
        }
    if (rows > 0) fputs("v 0 0.3 0\nv 0 -0.9 0\n", f);
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < columns; j++) {
            int a = first + (i - 1) * columns + j, b = first + (i - 1) * columns + (j + 1) % columns, c = a + columns, d = b + columns;
            if (i == 0) fprintf(f, "f %d %d %d\n", pole, d, c);
            else if (i == rows - 1) fprintf(f, "f %d %d %d\n", a, b, pole + 1);
            else fprintf(f, "f %d %d %d\nf %d %d %d\n", a, b, d, a, d, c);
        }
    close_file(f);
}

static void load(Scene *scene, const char *folder, BvhEffort effort)
{
    char path[1024];
    Report report = { .warnings = stderr };
    CameraSettings camera = { .has_size = true, .width = 160, .height = 120, .has_eye = true, .eye = { 0.7, 0.3, 0.9 }, .has_look = true, .look = { 0, -0.2, 0 },
                              .has_fov = true, .fov = 60 };
    snprintf(path, sizeof path, "%s/cost.obj", folder);
    if (!scene_load(scene, path, &camera, effort, &report)) fail(report.error);
    bvh_free(scene->bvh);                          /* once more, in processor time */
    double start = now();
    scene->bvh = bvh_new((const float (*)[3])scene->mesh.position, (const uint32_t (*)[3])scene->mesh.triangle, scene->mesh.n_triangles, effort);
    if (!scene->bvh) fail("out of memory");
    scene->seconds_build = now() - start;
}

/* ---- measuring ---- */

typedef struct { double nanoseconds, rays, edges; } Cost;      /* of a mutation; mean length of the states */

static void drop(void *context, const Path *path, double weight) { (void)context; (void)path; (void)weight; }

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static Cost measure(const Scene *scene, int which, int max_depth, double seconds)
{
    Space space = { .scene = scene, .max_depth = max_depth, .direct = DIRECT_INCLUDED };
    Sampler sampler = sampler_for(scene, set[which].allowed);
    if (set[which].uniform) sampler.tuning.p_d2_importance = 0;
    Bdpt *bdpt = bdpt_new();
    Path *x = calloc(1, sizeof *x), *y = calloc(1, sizeof *y);
    Bootstrap boot = { .sum = NULL };
    if (!bdpt || !x || !y || !bootstrap_run(&boot, &space, bdpt, STARTS, 1, 0)) fail("out of memory");
    Rng rng = rng_new(1, (uint64_t)1 << 40);
    ChainCount count = { 0 };
    double slice[SLICES], edges = 0, pieces = 0;
    uint64_t rays = 0, chains = 0, in_chain = CHAIN;
    for (int i = 0; i < SLICES; i++) {
        double spent = 0, steps = 0;
        while (spent < seconds / SLICES) {
            if (in_chain >= CHAIN) {
                if (!bootstrap_seed(&boot, &space, bdpt, even(0, chains++, 0), x)) fail("no light");
                in_chain = 0;
            }
            uint64_t before = *scene->rays;
            double start = now();
            chain_run(&space, &sampler, x, y, PIECE, &rng, drop, NULL, &count);
            spent += now() - start;
            rays += *scene->rays - before;
            steps += PIECE;
            in_chain += PIECE;
            edges += x->k;
            pieces++;
        }
        slice[i] = 1e9 * spent / steps;
    }
    qsort(slice, SLICES, sizeof *slice, by_value);
    bootstrap_free(&boot);
    bdpt_free(bdpt);
    free(x);
    free(y);
    return (Cost){ slice[SLICES / 2], (double)rays / (pieces * PIECE), edges / pieces };
}

/* ---- memory ---- */

static double peak_bytes(void)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return 1024.0 * (double)usage.ru_maxrss;
}

/* What a new program could have; INFINITY where the system does not say. */
static double free_bytes(void)
{
    double kilobytes = INFINITY;
    char line[256];
    FILE *f = fopen("/proc/meminfo", "r");
    while (f && fgets(line, sizeof line, f))
        if (sscanf(line, "MemAvailable: %lf", &kilobytes) == 1) break;
    if (f) fclose(f);
    return 1024 * kilobytes;
}

/* ---- the two parts ---- */

static void plot(const char *folder, const char *name, const SvgPlot *p)
{
    FILE *f = open_file(folder, name);
    svg_plot(f, p);
    close_file(f);
}

static void both(FILE *csv, const char *line)
{
    fputs(line, csv);
    fputs(line, stdout);
    fflush(stdout);
}

static void cost_of_triangles(const char *folder, double most, double seconds)
{
    static double triangles[SIZES], build[EFFORTS][SIZES], bytes[EFFORTS][SIZES], time[EFFORTS * SETS][SIZES];
    char line[300];
    FILE *csv = open_file(folder, "cost-triangles.csv");
    both(csv, "triangles,tree,seconds_build,tree_bytes_per_triangle,scene_bytes_per_triangle,peak_bytes,ns_bidir,rays_bidir,ns_all,rays_all\n");
    int n = 0;
    for (double want = 100; n < SIZES && want <= 1.001 * most; want *= 10, n++) {
        if (n > 3 && 10 * peak_bytes() > 0.8 * free_bytes()) {
            printf("stopped before %.0f triangles: not enough memory\n", want);
            break;
        }
        write_scene(folder, (uint32_t)want, 0.7);
        for (int e = 0; e < EFFORTS; e++) {
            Scene scene;
            load(&scene, folder, e ? BVH_BEST : BVH_FAST);
            triangles[n] = scene.mesh.n_triangles;
            build[e][n] = scene.seconds_build;
            bytes[e][n] = (double)bvh_bytes(scene.bvh) / triangles[n];
            Cost cost[SETS];
            for (int s = 0; s < SETS; s++) {
                cost[s] = measure(&scene, s, 16, seconds);
                time[e * SETS + s][n] = cost[s].nanoseconds;
            }
            snprintf(line, sizeof line, "%.0f,%s,%.4g,%.1f,%.1f,%.3g,%.0f,%.2f,%.0f,%.2f\n", triangles[n], effort_name[e], build[e][n], bytes[e][n],
                     (double)scene_bytes(&scene) / triangles[n], peak_bytes(), cost[0].nanoseconds, cost[0].rays, cost[1].nanoseconds, cost[1].rays);
            both(csv, line);
            scene_free(&scene);
        }
    }
    close_file(csv);
    const SvgSeries mutation[] = { { "bidir alone, fast tree", n, triangles, time[0] }, { "all, fast tree", n, triangles, time[1] },
                                   { "bidir alone, best tree", n, triangles, time[2] }, { "all, best tree", n, triangles, time[3] } };
    plot(folder, "cost-mutation.svg", &(SvgPlot){ .title = "A mutation against the size of the scene", .x_label = "triangles", .y_label = "nanoseconds per mutation",
                                                  .x_log = true, .count = EFFORTS * SETS, .series = mutation });
    const SvgSeries built[] = { { effort_name[0], n, triangles, build[0] }, { effort_name[1], n, triangles, build[1] } };
    plot(folder, "cost-build.svg", &(SvgPlot){ .title = "Building the tree", .x_label = "triangles", .y_label = "seconds", .x_log = true, .y_log = true, .count = EFFORTS, .series = built,
                                               .guide = true, .guide_slope = 1, .guide_name = "in proportion" });
    const SvgSeries large[] = { { effort_name[0], n, triangles, bytes[0] }, { effort_name[1], n, triangles, bytes[1] } };
    plot(folder, "cost-bytes.svg", &(SvgPlot){ .title = "The tree in memory", .x_label = "triangles", .y_label = "bytes per triangle", .x_log = true, .count = EFFORTS, .series = large });
}

static void cost_of_length(const char *folder, double seconds)
{
    static const int depth[DEPTHS] = { 2, 4, 8, 16, 32, 64, 128, MAX_EDGES };
    static double edges[ALL_SETS][DEPTHS], time[ALL_SETS][DEPTHS];
    char line[200];
    FILE *csv = open_file(folder, "cost-length.csv");
    both(csv, "max_depth,edges_bidir,ns_bidir,rays_bidir,edges_all,ns_all,rays_all,edges_uniform,ns_uniform,rays_uniform\n");
    write_scene(folder, 0, 0.99);
    Scene scene;
    load(&scene, folder, BVH_FAST);
    for (int d = 0; d < DEPTHS; d++) {
        Cost cost[ALL_SETS];
        for (int s = 0; s < ALL_SETS; s++) {
            cost[s] = measure(&scene, s, depth[d], seconds);
            edges[s][d] = cost[s].edges;
            time[s][d] = cost[s].nanoseconds;
        }
        int n = snprintf(line, sizeof line, "%d", depth[d]);
        for (int s = 0; s < ALL_SETS; s++) n += snprintf(line + n, 60, ",%.2f,%.0f,%.2f", cost[s].edges, cost[s].nanoseconds, cost[s].rays);
        snprintf(line + n, 2, "\n");
        both(csv, line);
    }
    scene_free(&scene);
    close_file(csv);
    const SvgSeries series[] = { { set[0].name, DEPTHS, edges[0], time[0] }, { set[1].name, DEPTHS, edges[1], time[1] },
                                 { set[2].name, DEPTHS, edges[2], time[2] } };
    plot(folder, "cost-length.svg", &(SvgPlot){ .title = "A mutation against the length of paths", .x_label = "mean edges of the chain's paths", .y_label = "nanoseconds per mutation",
                                                .count = ALL_SETS, .series = series });
}

int main(int argc, char **argv)
{
    double most = argc > 2 ? strtod(argv[2], NULL) : 1e7, seconds = argc > 3 ? strtod(argv[3], NULL) : 1;
    if (argc < 2 || argc > 4 || !(most >= 100 && most <= 1e8) || !(seconds > 0)) { fputs("usage: bench_cost FOLDER [MOST_TRIANGLES [SECONDS]]\n", stderr); return 2; }
    cost_of_triangles(argv[1], most, seconds);
    puts("");
    cost_of_length(argv[1], seconds);
    char path[1024];
    for (int i = 0; i < 2; i++)
        if (snprintf(path, sizeof path, "%s/cost.%s", argv[1], i ? "mtl" : "obj") < (int)sizeof path) remove(path);
    return 0;
}
