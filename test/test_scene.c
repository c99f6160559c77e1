/* Scenes in which things lie in one place: what rays find is what was sampled, whatever side they come from. And where a texture lies. */
#include "check.h"
#include "folder.h"
#include "scene.h"
#include "statistics.h"
#include <stdlib.h>

static bool load(Scene *s, const char *obj, Vec3 eye, Vec3 look)
{
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_eye = true, .eye = eye, .has_look = true, .look = look };
    folder_write_text("a.obj", obj);
    bool ok = scene_load(s, folder_path("a.obj"), &camera, BVH_FAST, &report);
    if (!CHECK(ok)) printf("%s\n", report.error);
    return ok;
}

static const char mtl[] = "newmtl lamp\nKd 0 0 0\nKe 1 1 1\nnewmtl wall\nKd 0.5 0.5 0.5\n";

/* ---- lamps ---- */

#define LAMP "v -0.5 0.3 -0.5\nv 0.5 0.3 -0.5\nv 0.5 0.3 0.5\nv -0.5 0.3 0.5\n"

/* From points on the side of y: every sampled point of a lamp that is seen from there is where a ray towards it ends, and the other way round,
 * every ray towards a place of the lamp ends on its front. Returns how many of a thousand sampled points are seen. */
static int look_at_lamp(const Scene *s, double y)
{
    Rng rng = rng_new(1, 1);
    int seen = 0;
    for (int i = 0; i < 1000; i++) {
        const double u[3] = { rng_double(&rng), rng_double(&rng), rng_double(&rng) };
        Point sampled, hit, from = { vec3(rng_double(&rng) - 0.5, y, rng_double(&rng) - 0.5), BVH_NONE, { NULL, { 0, 0, 0 }, { 0, 1, 0 }, { 0, 1, 0 } } };
        scene_sample_light(s, u, &sampled);
        Vec3 d = sub(sampled.p, from.p);
        bool visible = scene_visible(s, &from, &sampled) && dot(d, sampled.surface.ng) < 0;
        if (!CHECK(scene_trace(s, &from, normalize(d), &hit))) continue;
        if (!CHECK(material_emits(hit.surface.material) && dot(d, hit.surface.ng) < 0)) continue;
        if (visible) CHECK(hit.triangle == sampled.triangle);
        seen += visible;
    }
    return seen;
}

static void test_lamps(void)
{
    Scene s;
    folder_write_text("a.mtl", mtl);
    static const char ceiling[] = "mtllib a.mtl\nv -1 0.3 -1\nv 1 0.3 -1\nv 1 0.3 1\nv -1 0.3 1\nv 0 -1 0\nv 1 -1 0\nv 0 -1 1\nusemtl wall\nf 1 2 3 4\nf 5 6 7\n"
                                  "usemtl lamp\n" LAMP "f -4 -3 -2 -1\n";
    if (load(&s, ceiling, vec3(0, -0.5, 3), vec3(0, 0, 0))) {        /* below the ceiling, and shining down */
        CHECK(s.mesh.n_triangles == 5 && s.n_lights == 2);
        CHECK(look_at_lamp(&s, -0.6) == 1000);
        scene_free(&s);
    }
    if (load(&s, "mtllib a.mtl\nusemtl lamp\n" LAMP "f -4 -3 -2 -1\nf -1 -2 -3 -4\n", vec3(0, -0.5, 3), vec3(0, 0, 0))) {
        int below = look_at_lamp(&s, -0.7), above = look_at_lamp(&s, 1.3);   /* shining to both sides */
        CHECK(below > 400 && below < 600 && above > 400 && above < 600);
        scene_free(&s);
    }
    if (load(&s, "mtllib a.mtl\nusemtl lamp\n" LAMP "f -4 -3 -2 -1\n" LAMP "f -4 -3 -2 -1\nf -4 -3 -1\n", vec3(0, -0.5, 3), vec3(0, 0, 0))) {
        int seen = look_at_lamp(&s, -0.7);                           /* twice, and a part thrice: the last counts */
        CHECK(seen > 300 && seen < 600);
        scene_free(&s);
    }
    static const char closed[] = "mtllib a.mtl\nusemtl lamp\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";
    if (load(&s, closed, vec3(3, 3, 3), vec3(0, 0, 0))) {            /* lamps that share no place stay where they are, to the bit */
        CHECK(s.mesh.n_positions == 4);
        scene_free(&s);
    }
}

/* ---- which lamp to look at from a point ---- */

/* Of every lamp by itself: the chance that it is picked for the point, and how often it was. */
typedef struct { double expected, by_power; int picked; } Tally;

/* How unlikely the counts are, as a normal deviate, if lamps are picked as told, or by their power; rare ones together. */
static double deviate(const Tally *tally, uint32_t n, double samples, bool by_power)
{
    double chi_square = 0, rest = 0, rest_picked = 0, none = 1;
    int cells = 0, picked = 0;
    for (uint32_t i = 0; i < n; i++) {
        double expected = samples * (by_power ? tally[i].by_power : tally[i].expected);
        none -= expected / samples;
        picked += tally[i].picked;
        if (expected < 10) { rest += expected; rest_picked += tally[i].picked; continue; }
        chi_square += (tally[i].picked - expected) * (tally[i].picked - expected) / expected;
        cells++;
    }
    rest += samples * none;                    /* where nothing arrives from what the tree has */
    rest_picked += samples - picked;
    if (rest > 10) { chi_square += (rest_picked - rest) * (rest_picked - rest) / rest; cells++; }
    return chi_square_deviate(chi_square, cells - 1);
}

static void test_preference(void)
{
    enum { SAMPLES = 20000, POINTS = 40 };
    static const char *const file[] = { "test/scenes/lamps.obj", "scenes/glossy.obj" };
    for (int f = 0; f < 2; f++) {
        Scene s;
        Report report = { .warnings = NULL };
        const CameraSettings as_it_is = { .has_eye = false };
        double worst_density = 0, worst_sum = 0, worst = -INFINITY, least_by_power = INFINITY, highest = 0, lost = 0;
        if (!CHECK(scene_load(&s, file[f], &as_it_is, BVH_FAST, &report) && s.lamp_tree)) continue;
        Tally *tally = malloc(s.n_lights * sizeof *tally);
        Rng rng = rng_new(4, 0);
        for (int i = 0; i < POINTS; i++) {
            Point at, light;
            Vec3 w;
            do {                               /* what the eye sees, and where that scatters to */
                camera_sample_lens(&s.camera, &rng, &light);
                w = camera_direction(&s.camera, &light, s.camera.width * rng_double(&rng), s.camera.height * rng_double(&rng));
            } while (!scene_trace(&s, &light, w, &at));
            w = neg(w);
            if (i % 2 == 1) {
                light = at;
                Vec3 on = sample_cosine(dot(w, at.surface.ng) < 0 ? neg(at.surface.ng) : at.surface.ng, &rng);
                if (scene_trace(&s, &light, on, &at)) w = neg(on);
            }
            double sum = 0;
            for (uint32_t l = 0; l < s.n_lights; l++) {
                static const double place[3][2] = { { 0.01, 0.01 }, { 0.98, 0.01 }, { 0.01, 0.98 } };
                double preference = 0;
                for (int k = 0; k < 3; k++) {  /* some of a lamp may be below the horizon */
                    scene_triangle_point(&s, s.light[l], place[k][0], place[k][1], &light);
                    if (dot(sub(light.p, at.p), at.surface.ng) * dot(w, at.surface.ng) > 0) preference = scene_light_preference(&s, &at, &light);
                }
                double by_power = scene_triangle_area(&s, s.light[l]) * scene_light_pdf_a(&s, light.surface.material);
                tally[l] = (Tally){ preference * by_power, by_power, 0 };
                highest = fmax(highest, preference);
                sum += preference * by_power;
            }
            worst_sum = fmax(worst_sum, sum);
            for (int n = 0; n < SAMPLES; n++) {
                const double u[3] = { rng_double(&rng), rng_double(&rng), rng_double(&rng) };
                double density = scene_pick_light(&s, &at, w, u, &light);
                if (!(density > 0)) { lost++; continue; }
                uint32_t l = 0;
                while (s.light[l] != light.triangle) l++;
                tally[l].picked += tally[l].expected > 0;
                if (dot(sub(light.p, at.p), at.surface.ng) * dot(w, at.surface.ng) > 0)
                    worst_density = fmax(worst_density, fabs(density - scene_light_preference(&s, &at, &light)));
            }
            worst = fmax(worst, deviate(tally, s.n_lights, SAMPLES, false));
            least_by_power = fmin(least_by_power, deviate(tally, s.n_lights, SAMPLES, true));
        }
        printf("%s: lamps picked up to %.3g times as often as by power; chi-square of picks at most %.2f, by power at least %.0f; lost %.2g\n", file[f], highest, worst,
               least_by_power, lost / SAMPLES / POINTS);
        CHECK(worst_density == 0);
        CHECK(worst_sum < 1 + 1e-5);
        CHECK(worst < 4.5 && least_by_power > 10 && highest > 3);
        free(tally);
        scene_free(&s);
    }
    Scene one;                                 /* nothing to choose from */
    if (!load(&one, "mtllib a.mtl\nusemtl lamp\n" LAMP "f -4 -3 -2 -1\n", vec3(0, -0.5, 3), vec3(0, 0, 0))) return;
    CHECK(one.n_lights == 2 && !one.lamp_tree);
    scene_free(&one);
}

/* ---- the eye ---- */

/* How many of the rays through the film meet something within a millionth of the scene, and how many nothing. */
static void look_around(const Scene *s, int *near, int *nothing)
{
    Rng rng = rng_new(1, 2);
    *near = *nothing = 0;
    for (int i = 0; i < 1000; i++) {
        Point lens, hit;
        camera_sample_lens(&s->camera, &rng, &lens);
        Vec3 w = camera_direction(&s->camera, &lens, s->camera.width * rng_double(&rng), s->camera.height * rng_double(&rng));
        if (!scene_trace(s, &lens, w, &hit)) ++*nothing;
        else *near += length(sub(hit.p, lens.p)) < 1e-6;
    }
}

static void test_eye(void)
{
    /* a slope, seen by an eye that lies on it, from both sides; nothing else there */
    static const char slope[] = "v -1 -0.3 -1\nv 0 0.1 1.7\nv 1.1 0 -1\nf 1 2 3\n";
    Vec3 eye = scale(1.0 / 3, vec3(0.1, -0.2, -0.3));
    for (int up = 0; up < 2; up++) {
        Scene s;
        int near, nothing;
        if (!load(&s, slope, eye, add(eye, vec3(0, up ? 1 : -1, 0)))) return;
        look_around(&s, &near, &nothing);
        CHECK(near == 0 && nothing == 1000);
        CHECK(length(sub(add(s.mesh.centre, scale(s.mesh.unit, s.camera.eye)), eye)) < 1e-5);
        scene_free(&s);
    }
    /* a corner of three walls, seen by an eye in it */
    Scene s;
    int near, nothing;
    if (!load(&s, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\n", vec3(0, 0, 0), vec3(1, 1, 1))) return;
    look_around(&s, &near, &nothing);
    CHECK(near == 0 && nothing == 1000);
    scene_free(&s);
    /* one that only comes near stays */
    if (!load(&s, slope, add(eye, vec3(0, 1e-4, 0)), vec3(0, 0, 0))) return;
    CHECK_NEAR(s.mesh.centre.y + s.mesh.unit * s.camera.eye.y, eye.y + 1e-4, 1e-12);
    scene_free(&s);
}

/* ---- textures ---- */

/* The reflectance that the quad of uv 0..1 shows at (u, v). */
static double shown(const Scene *s, double u, double v)
{
    Point from = { scale(1 / s->mesh.unit, sub(vec3(u, v, 1), s->mesh.centre)), BVH_NONE, { NULL, { 0, 0, 0 }, { 0, 0, 1 }, { 0, 0, 1 } } }, hit;
    return scene_trace(s, &from, vec3(0, 0, -1), &hit) ? hit.surface.kd.x : NAN;
}

static void test_textures(void)
{
    static const struct { const char *options; double u, v, value; } list[] = {
        /* four texels in a row, 0 1 0 0 (linear), two rows; centres at 1/8, 3/8 .. */
        { "", 0.375, 0.75, 1 }, { "", 0.25, 0.75, 0.5 }, { "", 0.125, 0.75, 0 }, { "", 0.999, 0.75, 0 },
        /* the lower row is 1 0 0 0: at the border the last and the first mix, or do not */
        { "", 0.001, 0.25, 0.504 }, { "", 0.999, 0.25, 0.496 }, { "-clamp on", 0.001, 0.25, 1 }, { "-clamp on", 0.999, 0.25, 0 }, { "-clamp off", 0.999, 0.25, 0.496 },
        { "", 0.375, 0.999, 0.502 }, { "-clamp on", 0.375, 0.999, 1 },
        { "-s 2", 0.1875, 0.75, 1 }, { "-s 2", 0.6875, 0.75, 1 }, { "-s 1 2", 0.375, 0.375, 1 }, { "-s -1 1", 0.625, 0.75, 1 },
        { "-o 0.25", 0.125, 0.75, 1 }, { "-o 0 0.5 9", 0.375, 0.25, 1 }, { "-o -0.25", 0.625, 0.75, 1 }, { "-s 2 1 1 -o 0.5 0", 0.4375, 0.75, 1 },
        { "-clamp on -o -1 0", 0.6, 0.25, 1 }, { "-clamp on -s 3 1", 0.9, 0.25, 0 },
    };
    folder_write_text("t.ppm", "P3 4 2 255  0 0 0 255 255 255 0 0 0 0 0 0  255 255 255 0 0 0 0 0 0 0 0 0\n");
    for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
        char text[200];
        Scene s;
        snprintf(text, sizeof text, "newmtl paper\nmap_Kd %s t.ppm\n", list[i].options);
        folder_write_text("a.mtl", text);
        if (!load(&s, "mtllib a.mtl\nusemtl paper\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n", vec3(0, 0, 3), vec3(0, 0, 0))) return;
        if (!CHECK_NEAR(shown(&s, list[i].u, list[i].v), list[i].value, 1e-5)) printf("    %s at %g %g\n", list[i].options, list[i].u, list[i].v);
        scene_free(&s);
    }
}

int main(void)
{
    test_lamps();
    test_preference();
    test_eye();
    test_textures();
    return check_report();
}
