/* Walks that are bent through specular vertices to meet a lamp (bend.h): light that arrives at points of a scene, found by them and by chance together, is
 * what chance alone finds. Planted faults must be caught.
 *
 *     test_bend [FACTOR [SEED]]        FACTOR times the samples; another seed
 */
#include "bend.h"
#include "check.h"
#include "folder.h"
#include "statistics.h"
#include <stdlib.h>
#include <string.h>

static double factor = 1;
static uint64_t seed = 1;

enum { RUNS = 20, POINTS = 6, ALL = POINTS };      /* points looked at; and their mean */
typedef struct { double value[RUNS][POINTS + 1]; } Group;

/* What may be wrong: the number of guesses is left out; what chance finds counts in full beside bent walks; or never does, where they do not find it. */
typedef enum { RIGHT, UNBENT, NO_GUESSES, CHANCE_IN_FULL, NO_REST } Way;

/* A point that is not specular, met from the direction 'known' by a ray of the camera, or by one that went on from there. */
typedef struct { Point at; Vec3 known; } Looked;

static bool look(const Scene *scene, Rng *rng, Looked *out)
{
    Point from;
    Mode mode;
    camera_sample_lens(&scene->camera, rng, &from);
    Vec3 w = camera_direction(&scene->camera, &from, rng_double(rng) * scene->camera.width, rng_double(rng) * scene->camera.height);
    for (int edges = 0; edges < 6; edges++) {
        if (!scene_trace(scene, &from, w, &out->at)) return false;
        out->known = neg(w);
        if (!material_is_specular(out->at.surface.material)) return !material_emits(out->at.surface.material);
        from = out->at;
        if (!bsdf_sample(&from.surface, out->known, rng, &w, &mode)) return false;
    }
    return false;
}

/* The light that a walk from v[top] meets by chance, if specular vertices are all that is between, and at least one. */
static double by_chance(const Scene *scene, Vertex *v, int top, Vec3 known, Way way, Rng *rng)
{
    Rgb carried = vec3(1, 1, 1);
    Vec3 w;
    double sum = 0;
    for (int i = top; i > 0; i--) {
        Scatter s;
        if (!bsdf_sample(&v[i].point.surface, known, rng, &w, &v[i].mode) || !scene_trace(scene, &v[i].point, w, &v[i - 1].point)) break;
        w = normalize(sub(v[i - 1].point.p, v[i].point.p));
        if (!bsdf_scatter(&v[i].point.surface, w, known, v[i].mode, &s) || !(s.inv_S_light > 0)) break;
        carried = mul(carried, scale(1 / s.inv_S_light, s.colour));
        known = neg(w);
        const Surface *to = &v[i - 1].point.surface;
        if (i < top && material_emits(to->material) && dot(known, to->ng) > 0) {
            v[i - 1].mode = MODE_NONE;
            BendLeft left = { 1, 1 };
            if (way != UNBENT && way != CHANCE_IN_FULL) left = bend_left(scene, &v[i - 1], 1 + top - (i - 1), rng);
            if (way == NO_REST) left.times = 1;
            sum += left.share * left.times * luminance(mul(carried, to->material->ke));
        }
        if (!material_is_specular(to->material)) break;
    }
    return sum;
}

typedef struct { Way way; double sum; int ways; } Sum;
static void add_bent(void *context, const Bent *bent)
{
    Sum *s = context;
    double times = s->way == NO_GUESSES ? fmin(bent->times, 1) : bent->times;
    s->sum += times * luminance(bent->rgb) / (bent->chance_pdf_a + bent->pdf_a);
    s->ways++;
}

static Group look_at(const Scene *scene, const Looked looked[POINTS], Way way, int n, int *ways)
{
    enum { TOP = MOST_SPECULAR + 1 };
    Group g = { { { 0 } } };
    Vertex *v = calloc(TOP + 2, sizeof *v);
    if (!v) abort();
    for (int run = 0; run < RUNS; run++)
        for (int i = 0; i < POINTS; i++) {
            Rng rng = rng_new(seed, ((uint64_t)way << 20) + (uint64_t)(run * POINTS + i));
            Sum s = { .way = way };
            for (int j = 0; j < n; j++) {
                v[TOP + 1].point.p = along(looked[i].at.p, 1, looked[i].known);    /* where the walk has come from */
                v[TOP].point = looked[i].at;
                v[TOP].mode = MODE_NONE;
                s.sum += by_chance(scene, v, TOP, looked[i].known, way, &rng);
                const double light[3] = { rng_double(&rng), rng_double(&rng), rng_double(&rng) };
                v[TOP].mode = MODE_NONE;
                if (way != UNBENT) bend_walk(scene, &v[TOP], TOP, looked[i].known, light, &rng, add_bent, &s);
            }
            g.value[run][i] = s.sum / n;
            g.value[run][ALL] += g.value[run][i] / POINTS;
            if (ways) *ways += s.ways;
        }
    free(v);
    return g;
}

static double least_chance(const Group *a, const Group *b)
{
    double least = 1;
    for (int i = 0; i <= POINTS; i++) {
        double mean_a, mean_b, variance_a, variance_b, t;
        mean_and_variance(&a->value[0][i], POINTS + 1, RUNS, &mean_a, &variance_a);
        mean_and_variance(&b->value[0][i], POINTS + 1, RUNS, &mean_b, &variance_b);
        double chance = welch_chance(mean_a, variance_a, RUNS, mean_b, variance_b, RUNS, &t);
        if (chance < least || isnan(chance)) least = chance;
    }
    return least;
}

/* Water with ripples over a floor, a large lamp that chance finds too, and a mirror that emits. */
static void write_scene(void)
{
    static char text[400000];
    size_t n = 0;
    enum { ROWS = 24 };
    n += (size_t)snprintf(text + n, sizeof text - n, "mtllib bend.mtl\n");
    for (int i = 0; i <= ROWS; i++)
        for (int j = 0; j <= ROWS; j++) {
            double x = 2.0 * i / ROWS - 1, z = 2.0 * j / ROWS - 1, slope_x = 0.25 * cos(5 * x), slope_z = 0.2 * cos(4 * z);
            n += (size_t)snprintf(text + n, sizeof text - n, "v %g %g %g\nvn %g 1 %g\n", x, 0.05 * sin(5 * x) + 0.05 * sin(4 * z), z, -slope_x, -slope_z);
        }
    n += (size_t)snprintf(text + n, sizeof text - n, "v -1 -1 -1\nv 1 -1 -1\nv 1 -1 1\nv -1 -1 1\nv -.5 1 -.5\nv .5 1 -.5\nv .5 1 .5\nv -.5 1 .5\n"
                                                          "v .6 1 -.5\nv .9 1 -.5\nv .9 1 .5\nv .6 1 .5\nusemtl water\n");
    for (int i = 0; i < ROWS; i++)
        for (int j = 0; j < ROWS; j++) {
            int a = i * (ROWS + 1) + j + 1, b = a + 1, c = a + ROWS + 2, d = a + ROWS + 1;
            n += (size_t)snprintf(text + n, sizeof text - n, "f %d//%d %d//%d %d//%d %d//%d\n", a, a, b, b, c, c, d, d);
        }
    snprintf(text + n, sizeof text - n, "usemtl floor\nf -9 -10 -11 -12\nusemtl lamp\nf -8 -7 -6 -5\nusemtl mirror\nf -4 -3 -2 -1\n");
    folder_write_text("water.obj", text);
    folder_write_text("bend.mtl", "newmtl water\nillum 4\nNi 1.33\nnewmtl floor\nKd 0.6 0.6 0.6\nnewmtl lamp\nKd 0 0 0\nKe 5 4 3\n"
                                  "newmtl mirror\nillum 3\nKs 0.8 0.8 0.8\nKe 4 4 4\nnewmtl glass\nillum 4\nNi 1.5\n");
    folder_write_text("water.cam", "eye 0 -0.5 0.9\nlook 0 -1 -0.3\nfov 60\n");
}

/* A large lamp inside a ball of glass, beside a floor: some ways there are hardly ever found again, though chance finds them. */
static void write_ball(void)
{
    static char text[400000];
    size_t n = 0;
    enum { ROWS = 24, COLUMNS = 48 };
    n += (size_t)snprintf(text + n, sizeof text - n, "mtllib bend.mtl\n");
    for (int ball = 0; ball < 2; ball++)
        for (int i = 0; i <= ROWS; i++)
            for (int j = 0; j <= COLUMNS; j++) {
                double a = PI * i / ROWS, b = 2 * PI * j / COLUMNS, r = ball ? 0.25 : 0.17, x = sin(a) * cos(b), y = cos(a), z = -sin(a) * sin(b);
                n += (size_t)snprintf(text + n, sizeof text - n, "v %.7f %.7f %.7f\nvn %.7f %.7f %.7f\n", r * x, r * y, r * z, x, y, z);
            }
    for (int ball = 0; ball < 2; ball++) {
        n += (size_t)snprintf(text + n, sizeof text - n, "usemtl %s\n", ball ? "glass" : "lamp");
        for (int i = 0; i < ROWS; i++)
            for (int j = 0; j < COLUMNS; j++) {
                int a = (ball * (ROWS + 1) + i) * (COLUMNS + 1) + j + 1, b = a + 1, c = a + COLUMNS + 2, d = a + COLUMNS + 1;
                n += (size_t)snprintf(text + n, sizeof text - n, "f %d//%d %d//%d %d//%d %d//%d\n", a, a, d, d, c, c, b, b);
            }
    }
    snprintf(text + n, sizeof text - n, "v -1 -.4 -1\nv -1 -.4 1\nv 1 -.4 1\nv 1 -.4 -1\nusemtl floor\nf -4 -3 -2 -1\n");
    folder_write_text("ball.obj", text);
    folder_write_text("ball.cam", "eye 0 0.6 1.2\nlook 0 -.4 0.1\nfov 40\n");
}

static bool load(Scene *scene, const char *file)
{
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_size = true, .width = 16, .height = 16 };
    bool ok = scene_load(scene, file, &camera, BVH_FAST, &report);
    if (!CHECK(ok)) printf("%s: %s\n", file, report.error);
    return ok;
}

static void test_points(const Scene *scene, const char *file, int n)
{
    Looked looked[POINTS];
    Rng rng = rng_new(seed, 1);
    for (int i = 0; i < POINTS; ) i += look(scene, &rng, &looked[i]);
    int ways = 0;
    Group plain = look_at(scene, looked, UNBENT, 4 * n, NULL), both = look_at(scene, looked, RIGHT, n, &ways);
    Group no_guesses = look_at(scene, looked, NO_GUESSES, n, NULL), in_full = look_at(scene, looked, CHANCE_IN_FULL, n, NULL);
    double mean, variance, mean_both, variance_both;
    mean_and_variance(&plain.value[0][ALL], POINTS + 1, RUNS, &mean, &variance);
    mean_and_variance(&both.value[0][ALL], POINTS + 1, RUNS, &mean_both, &variance_both);
    double chance = least_chance(&plain, &both);
    printf("%s: by chance %.5f +- %.5f, bent too %.5f +- %.5f, %d ways, least chance %.1g\n", file, mean, sqrt(variance), mean_both, sqrt(variance_both), ways, chance);
    static const double CHANCE = 1e-6 / 200;
    CHECK(mean > 0 && ways > 1000);
    CHECK(chance > CHANCE);
    double guesses = least_chance(&plain, &no_guesses), full = least_chance(&plain, &in_full);
    printf("    planted: guesses not counted %.1g, chance in full %.1g\n", guesses, full);
    CHECK(guesses < CHANCE);
    CHECK(full < CHANCE);
    if (strcmp(file, "ball") != 0) return;
    Group no_rest = look_at(scene, looked, NO_REST, n, NULL);
    double rest = least_chance(&plain, &no_rest);
    printf("    planted: rest of guesses not counted %.1g\n", rest);
    CHECK(rest < CHANCE);
}

/* A path through a thin pane is the same whichever end it was traced from: where two points are so near each other, the direction between them must not be
 * lost in what keeps rays off surfaces. Else a way found from the lamp is none that bent walks know, and both count in full. */
static void test_pane(void)
{
    Scene scene;
    folder_write_text("pane.obj", "mtllib bend.mtl\nv -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv -1 0.001 -1\nv 1 0.001 -1\nv 1 0.001 1\nv -1 0.001 1\nv -1 -1 -1\nv 1 -1 -1\n"
                                  "v 1 -1 1\nv -1 -1 1\nv -.1 1 -.1\nv .1 1 -.1\nv .1 1 .1\nv -.1 1 .1\nusemtl water\nf 1 2 3 4\nf 8 7 6 5\nusemtl floor\nf 12 11 10 9\nusemtl lamp\nf 13 14 15 16\n");
    if (!load(&scene, folder_path("pane.obj"))) return;
    Rng rng = rng_new(seed, 2);
    double worst = 0;
    int n = 0, through = 0;
    for (int i = 0; i < 4000; i++) {
        Vertex v[4];
        Mode mode[3] = { MODE_NONE, MODE_REFRACT, MODE_REFRACT };
        const double u[3] = { rng_double(&rng), rng_double(&rng), rng_double(&rng) };
        scene_sample_light(&scene, u, &v[0].point);
        v[0].mode = v[3].mode = MODE_NONE;
        Vec3 w = sample_cosine(v[0].point.surface.ng, &rng);
        bool found = true;
        for (int j = 0; j < 3 && found; j++) {
            v[j].mode = mode[j];
            found = (j == 0 || bsdf_follow(&v[j].point.surface, neg(v[j - 1].to_lens), v[j].mode, &w)) && scene_trace(&scene, &v[j].point, w, &v[j + 1].point);
            v[j].to_lens = normalize(sub(v[j + 1].point.p, v[j].point.p));
        }
        if (!found || !material_is_specular(v[1].point.surface.material) || !material_is_specular(v[2].point.surface.material)) continue;
        for (int j = 2; j > 0; j--) {
            CHECK(bsdf_follow(&v[j].point.surface, v[j].to_lens, v[j].mode, &w));
            worst = fmax(worst, length(add(w, v[j - 1].to_lens)));
        }
        n++;
        through += specular_way(&scene, v, 3).through;
    }
    printf("thin pane: %d ways from a lamp, %d of them found from the straight line back to it; directions off by %.2g\n", n, through, worst);
    CHECK(n > 500 && through > 0.999 * n && worst < 1e-9);
    scene_free(&scene);
}

int main(int argc, char **argv)
{
    if (argc > 1) factor = atof(argv[1]);
    if (argc > 2) seed = (uint64_t)atoi(argv[2]);
    write_scene();
    write_ball();
    const char *const file[] = { folder_path("water.obj"), folder_path("ball.obj"), "test/scenes/underwater.obj", "test/scenes/mirror-smooth.obj", "test/scenes/water-smooth.obj" };
    for (int i = 0; i < 5; i++) {
        Scene scene;
        if (!load(&scene, file[i])) continue;
        test_points(&scene, i == 0 ? "water" : i == 1 ? "ball" : file[i], (int)(3000 * factor));
        scene_free(&scene);
    }
    test_pane();
    return check_report();
}
