/* Scenes that break renderers, each rendered by the path tracer, the bidirectional path tracer and the Metropolis sampler: all values finite, no
 * bad sample, and the pictures agree tile by tile, or are what they must be. The unit of variance is the independent run. Faults planted in the
 * pictures must be caught by the same comparisons.
 *
 *     stress [LANES [PART-OF-A-NAME [FACTOR]]]      so many rows at a time, 2 if not given; only some rows; so many times the samples
 *
 * Every row runs in a process of its own, so that one that crashes or hangs is one failure.
 */
#include "check.h"
#include "folder.h"
#include "render.h"
#include "statistics.h"
#include "stress_scenes.h"
#include <sys/wait.h>

/* ---- the table of rows ---- */

enum { TILES = 3, RUNS = 20, VALUES = TILES * TILES + 4 };                /* luminance of each tile and of all, then red, green, blue of all */
enum { ESTIMATORS = 3, PATH = 0, BDPT = 1, MLT = 2 };

/* Which estimators can be compared tile by tile; a path tracer that misses the light nearly always is no normal variable. */
typedef enum { ALL_AGREE, WITHOUT_PATH, BLACK } Kind;
typedef enum { NO_FAULT, FAULT_SCALED, FAULT_TILE, FAULT_NO_DIRECT, FAULT_INFINITE } Planted;

typedef struct {
    const char *name;
    void (*write)(Files *files, double parameter);
    double parameter;
    uint32_t width, height;        /* film, 24x24 if 0 */
    int max_depth;                 /* 5 if 0 */
    double effort;                 /* times the samples, 1 if 0 */
    Kind kind;
    double expected;               /* value of every pixel, 0 = unknown */
    DirectLight direct;
    Planted fault;                 /* the row passes if the fault is caught */
} Row;

static const Row rows[] = {
    { .name = "a room", .write = furnished },
    { .name = "zero-area and sliver triangles", .write = slivers },
    { .name = "faces twice, lamps too", .write = duplicates },
    { .name = "lamp with two faces in one place", .write = two_sided_lamp },
    { .name = "coplanar faces", .write = coplanar },
    { .name = "coplanar faces, other materials", .write = coplanar_colours },
    { .name = "lamps that touch walls", .write = touching_lamp },
    { .name = "lamp in the ceiling's plane", .write = lamp_in_ceiling },
    { .name = "corners in corners", .write = corners },
    { .name = "open glass, large lamp", .write = open_glass, .parameter = 0.75, .max_depth = 8 },
    { .name = "open glass, small lamp", .write = open_glass, .parameter = 0.125, .max_depth = 6, .kind = WITHOUT_PATH, .effort = 8 },
    { .name = "eye on the floor", .write = eye_on_floor },
    { .name = "eye on a sloping floor", .write = eye_on_floor, .parameter = 0.1 },
    { .name = "eye in glass", .write = eye_in_glass, .max_depth = 8 },
    { .name = "eye under water", .write = under_water, .max_depth = 7, .effort = 3 },
    { .name = "lamps of no area, of no power", .write = odd_lights },
    { .name = "Ns 0", .write = glossy, .parameter = 0 },
    { .name = "Ns 1", .write = glossy, .parameter = 1 },
    { .name = "Ns 1e3", .write = glossy, .parameter = 1e3 },
    { .name = "Ns 1e8", .write = glossy, .parameter = 1e8 },
    { .name = "Ni 0.1", .write = refraction, .parameter = 0.1, .max_depth = 8 },
    { .name = "Ni 1", .write = refraction, .parameter = 1, .max_depth = 8 },
    { .name = "Ni 1.000001", .write = refraction, .parameter = 1.000001, .max_depth = 8 },
    { .name = "Ni 10", .write = refraction, .parameter = 10, .max_depth = 8 },
    { .name = "radiance 1e-20", .write = radiance, .parameter = 1e-20 },
    { .name = "radiance 1e20", .write = radiance, .parameter = 1e20 },
    { .name = "radiance 1e20, reflectance 1e-10", .write = vast_range, .max_depth = 64 },
    { .name = "the same without direct light", .write = vast_range, .max_depth = 64, .direct = LIGHT_NONE },
    { .name = "a million triangles", .write = million },
    { .name = "1e6 units from the origin", .write = far_room, .parameter = 1e6 },
    { .name = "1e-6 units large", .write = placed_room, .parameter = 1e-6 },
    { .name = "1e9 units large", .write = placed_room, .parameter = 1e9 },
    { .name = "ground plane of aspect 1e6", .write = long_plane, .parameter = 1e6 },
    { .name = "mirror furnace, 64 edges", .write = mirror_furnace, .max_depth = 64, .direct = LIGHT_CHAIN, .expected = 9.988209814 },
    { .name = "furnace, 255 edges", .write = diffuse_furnace, .max_depth = 255, .expected = 10, .effort = 0.5 },
    { .name = "thirty panes, 64 edges", .write = panes, .max_depth = 64, .effort = 0.1 },
    { .name = "normals that lean over", .write = bent_normals, .max_depth = 6 },
    { .name = "thin lens", .write = thin_lens },
    { .name = "no light", .write = no_light, .kind = BLACK },
    { .name = "light that nothing sees", .write = hidden_light, .kind = BLACK },
    { .name = "textured quad", .write = textured },
    { .name = "rays along the axes", .write = axis_rays, .parameter = 1e-50, .width = 1, .height = 1, .effort = 100 },
    { .name = "rays nearly along the axes", .write = axis_rays, .parameter = 1e-6 },
    { .name = "paths of 1 edge", .write = furnished, .max_depth = 1 },
    { .name = "paths of up to 2 edges", .write = furnished, .max_depth = 2 },
    { .name = "paths of up to 3 edges", .write = furnished, .max_depth = 3 },
    { .name = "paths of up to 255 edges", .write = furnished, .max_depth = 255 },
    { .name = "film of 1x1", .write = furnished, .width = 1, .height = 1, .effort = 100 },
    { .name = "film of 1x48", .write = furnished, .width = 1, .height = 48, .effort = 12 },
    { .name = "film of 48x1", .write = furnished, .width = 48, .height = 1, .effort = 48 },
    { .name = "planted: mlt 3 % too bright", .write = furnished, .fault = FAULT_SCALED },
    { .name = "planted: one tile of bdpt 10 % darker", .write = furnished, .fault = FAULT_TILE },
    { .name = "planted: mlt without its direct light", .write = furnished, .fault = FAULT_NO_DIRECT },
    { .name = "planted: one value is infinite", .write = furnished, .fault = FAULT_INFINITE },
};
enum { ROWS = sizeof rows / sizeof rows[0] };

/* A false alarm of the whole program once in a million, by any of at most three pairs of values in each row. */
static const double CHANCE = 1e-6 / (ROWS * VALUES * 3);
static const double T_FOUND = 8.3;                 /* where Student's |t| of two groups of RUNS has about that chance */

/* ---- runs ---- */

/* Independent runs of one estimator. */
typedef struct {
    bool ok, finite;
    uint64_t bad;
    double error;                  /* the largest that a run has estimated; NAN if none has */
    double value[RUNS][VALUES];
} Group;

static bool always(void *context, const Render *render) { (void)context; (void)render; return true; }

/* Means over tiles and over all. Where a film is narrower than the tiles are many, some stay 0. */
static void take_picture(Group *g, int run, const Image *image)
{
    double pixels[TILES * TILES] = { 0 }, n = (double)image->width * image->height, *value = g->value[run];
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            Rgb c = from_float(image->rgb + 3 * ((size_t)y * image->width + x));
            uint32_t tile = y * TILES / image->height * TILES + x * TILES / image->width;
            if (!finite3(c) || c.x < 0 || c.y < 0 || c.z < 0) g->finite = false;
            value[tile] += luminance(c);
            pixels[tile]++;
            value[TILES * TILES] += luminance(c) / n;
            value[TILES * TILES + 1] += c.x / n;
            value[TILES * TILES + 2] += c.y / n;
            value[TILES * TILES + 3] += c.z / n;
        }
    for (int i = 0; i < TILES * TILES; i++)
        if (pixels[i] > 0) value[i] /= pixels[i];
}

static void render_group(Group *g, const Scene *scene, const Row *row, int estimator, double factor)
{
    static const Integrator integrator[ESTIMATORS] = { INTEGRATOR_PATH, INTEGRATOR_BDPT, INTEGRATOR_MLT };
    static const double per_pixel[ESTIMATORS] = { 64, 16, 64 };
    double effort = factor * (row->effort > 0 ? row->effort : 1), least = estimator == MLT ? 0 : 1;    /* no pixel without a sample */
    *g = (Group){ .ok = true, .finite = true, .error = NAN };
    for (int i = 0; g->ok && i < RUNS; i++) {
        Settings s = {
            .integrator = integrator[estimator], .direct = row->direct, .max_depth = row->max_depth ? row->max_depth : 5, .strategies = ~0u,
            .seed = (uint64_t)((row - rows) * ESTIMATORS + estimator) * RUNS + (uint64_t)i, .per_pixel = fmax(least, effort * per_pixel[estimator]), .bootstrap = (uint64_t)ceil(4000 * factor),
        };
        if (row->fault == FAULT_NO_DIRECT && estimator == MLT) s.direct = LIGHT_NONE;
        Render *r = render_new(scene, &s);
        Image *image = image_new(scene->camera.width, scene->camera.height);
        g->ok = r && image && render_run(r, always, NULL);
        if (g->ok) {
            RenderStats stats = render_stats(r);
            render_image(r, image);
            if (row->fault == FAULT_INFINITE && i == 3) image->rgb[100] = INFINITY;
            take_picture(g, i, image);
            g->bad += stats.bad_samples;
            g->error = fmax(g->error, stats.relative_error);              /* of the two, the one that is a number */
        }
        render_free(r);
        image_free(image);
    }
}

/* ---- comparisons ---- */

static void moments(const Group *g, int v, double *mean, double *variance)
{
    mean_and_variance(&g->value[0][v], VALUES, RUNS, mean, variance);
}

static double mean_luminance(const Group *g)
{
    double mean, variance;
    moments(g, TILES * TILES, &mean, &variance);
    return mean;
}

/* How large a relative difference of the means would be found, were it the only one: some standard errors. */
static double smallest_found(const Group *a, const Group *b)
{
    double mean_a, mean_b, variance_a, variance_b;
    moments(a, TILES * TILES, &mean_a, &variance_a);
    moments(b, TILES * TILES, &mean_b, &variance_b);
    return mean_a > 0 && isfinite(mean_a) ? T_FOUND * sqrt(variance_a + variance_b) / mean_a : 0;
}

/* Whether all values agree, and the largest |t| met. */
static bool agree(const Group *a, const Group *b, double *largest)
{
    bool good = true;
    *largest = 0;
    for (int v = 0; v < VALUES; v++) {
        double mean_a, mean_b, variance_a, variance_b, t;
        moments(a, v, &mean_a, &variance_a);
        moments(b, v, &mean_b, &variance_b);
        if (fabs(mean_a - mean_b) <= 1e-6 * fabs(mean_a)) continue;       /* exact pixels, or black ones */
        good &= welch_chance(mean_a, variance_a, RUNS, mean_b, variance_b, RUNS, &t) > CHANCE;
        *largest = fmax(*largest, t);
    }
    return good;
}

static bool agree_with(const Group *a, double expected, double *largest)
{
    Group exact;
    for (int i = 0; i < RUNS; i++)
        for (int v = 0; v < VALUES; v++) exact.value[i][v] = expected;
    return agree(&exact, a, largest);
}

static void plant(Group group[ESTIMATORS], Planted fault)
{
    for (int i = 0; i < RUNS; i++) {
        if (fault == FAULT_TILE) group[BDPT].value[i][4] *= 0.9;
        for (int v = 0; fault == FAULT_SCALED && v < VALUES; v++) group[MLT].value[i][v] *= 1.03;
    }
}

/* Runs a row, prints its line; true if it is as it should be. */
static bool run_row(const Row *row, const Scene *scene, double factor, double start)
{
    static Group group[ESTIMATORS];
    bool good = true, sound = true;                /* sound: what no planted fault excuses */
    double error = NAN, z_bdpt = 0, z_mlt = 0, mean[ESTIMATORS];
    uint64_t bad = 0;
    for (int e = 0; e < ESTIMATORS; e++) {
        render_group(&group[e], scene, row, e, factor);
        good &= group[e].finite;
        sound &= group[e].ok && group[e].bad == 0 && (group[e].finite || row->fault == FAULT_INFINITE);
        bad += group[e].bad;
        error = fmax(error, group[e].error);
    }
    plant(group, row->fault);
    for (int e = 0; e < ESTIMATORS; e++) {
        mean[e] = mean_luminance(&group[e]);
        double t = 0;
        if (row->expected > 0) good &= agree_with(&group[e], row->expected, &t);
        if (row->kind == BLACK) good &= mean[e] == 0;
        else good &= mean[e] > 0;
    }
    good &= agree(&group[row->kind == WITHOUT_PATH ? MLT : PATH], &group[BDPT], &z_bdpt);
    if (row->kind != WITHOUT_PATH) good &= agree(&group[PATH], &group[MLT], &z_mlt);
    double found = smallest_found(&group[row->kind == WITHOUT_PATH ? BDPT : PATH], &group[MLT]);
    char path_bdpt[16] = "-", path_mlt[16] = "-", bdpt_mlt[16] = "-";
    snprintf(row->kind == WITHOUT_PATH ? bdpt_mlt : path_bdpt, 16, "%.1f", z_bdpt);
    if (row->kind != WITHOUT_PATH) snprintf(path_mlt, 16, "%.1f", z_mlt);
    good = sound && good == (row->fault == NO_FAULT);
    printf("%-38s %8u %10.4g %10.4g %10.4g %9s %9s %9s %6.1f%% %7.2g %4llu %6.1f %s\n", row->name, (unsigned)scene->mesh.n_triangles, mean[PATH], mean[BDPT], mean[MLT],
           path_bdpt, path_mlt, bdpt_mlt, 100 * found, error, (unsigned long long)bad, clock_now() - start,
           good ? row->fault != NO_FAULT ? "caught" : "passed" : row->fault != NO_FAULT ? "NOT CAUGHT" : "FAILED");
    return good;
}

/* ---- files and processes ---- */

enum { LONGEST_ROW = 300 };                        /* seconds */

static const char *row_file(int row, const char *ending)
{
    char name[32];
    snprintf(name, sizeof name, "row%d.%s", row, ending);
    return folder_path(name);
}

static const char *const ending[4] = { "obj", "mtl", "cam", "ppm" };

static bool write_scene(const Row *row, int number)
{
    char name[16];
    FILE *file[4];
    bool good = true;
    for (int i = 0; i < 4; i++) {
        file[i] = fopen(row_file(number, ending[i]), "wb");
        good &= file[i] != NULL;
    }
    snprintf(name, sizeof name, "row%d", number);
    Files f = { file[0], file[1], file[2], file[3], name, 1, { 0, 0, 0 } };
    if (good) {
        fprintf(f.obj, "mtllib %s.mtl\n", name);
        row->write(&f, row->parameter);
    }
    for (int i = 0; i < 4; i++)
        if (file[i]) good &= fclose(file[i]) == 0;
    return good;
}

static void remove_scene(int number)
{
    for (int i = 0; i < 4; i++) unlink(row_file(number, ending[i]));
}

/* What a child does: its exit code. Loading and building count as its seconds. */
static int do_row(int number, double factor)
{
    const Row *row = &rows[number];
    double start = clock_now();
    Scene scene;
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_size = true, .width = row->width ? row->width : 24, .height = row->height ? row->height : 24 };
    alarm((unsigned)ceil(LONGEST_ROW * fmax(1, factor)));
    if (!write_scene(row, number) || !scene_load(&scene, row_file(number, "obj"), &camera, BVH_FAST, &report)) {
        printf("%-38s cannot be loaded: %s\n", row->name, report.error);
        return 1;
    }
    bool good = run_row(row, &scene, factor, start);
    scene_free(&scene);
    return !good;
}

typedef struct { pid_t process; int row; } Lane;

/* Waits for any child and counts it; false if there is none. */
static bool finish_one(Lane *lane, int lanes)
{
    int status;
    pid_t process = wait(&status);
    if (process < 0) return false;
    for (int i = 0; i < lanes; i++) {
        if (lane[i].process != process) continue;
        if (WIFSIGNALED(status)) printf("%-38s ended by signal %d: FAILED\n", rows[lane[i].row].name, WTERMSIG(status));
        check_count(WIFEXITED(status) && WEXITSTATUS(status) == 0);
        remove_scene(lane[i].row);
        lane[i].process = 0;
    }
    return true;
}

int main(int argc, char **argv)
{
    enum { MOST_LANES = 16 };
    Lane lane[MOST_LANES] = { { 0, 0 } };
    int lanes = argc > 1 ? atoi(argv[1]) : 2;
    const char *part = argc > 2 ? argv[2] : "";
    double factor = argc > 3 ? atof(argv[3]) : 1, start = clock_now();
    if (!(factor > 0)) factor = 1;
    if (lanes < 1 || lanes > MOST_LANES) lanes = 1;
    folder();                                      /* made before the children are: one for all */
    printf("mean luminance of each estimator; largest |t| over tiles and colours of each pair that is compared; difference of path and\n"
           "mlt (bdpt and mlt) as a whole that would be found; estimated relative error; bad samples; seconds\n"
           "%-38s %8s %10s %10s %10s %9s %9s %9s %7s %7s %4s %6s\n", "", "triangles", "path", "bdpt", "mlt", "path/bdpt", "path/mlt", "bdpt/mlt", "found", "error", "bad", "s");
    for (int i = 0; i < ROWS; i++) {
        if (!strstr(rows[i].name, part)) continue;
        int free_lane = 0;
        while (free_lane < lanes && lane[free_lane].process) free_lane++;
        if (free_lane == lanes) {
            finish_one(lane, lanes);
            i--;
            continue;
        }
        fflush(stdout);
        pid_t process = fork();
        if (process == 0) {
            int code = do_row(i, factor);
            fflush(stdout);
            _exit(code);
        }
        if (process < 0) { perror("fork"); check_count(0); break; }
        lane[free_lane] = (Lane){ process, i };
    }
    while (finish_one(lane, lanes)) {}
    printf("%.0f s\n", clock_now() - start);
    return check_report();
}
