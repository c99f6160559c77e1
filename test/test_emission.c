/* Learned directions of emission (emission.h): what is drawn has the density that is told; what is learned is where light went, and nothing where it goes as
 * the cosine law has it; however many directions are told. Planted faults must be caught.
 *
 *     test_emission [SEED]
 */
#include "bsdf.h"
#include "check.h"
#include "emission.h"
#include "statistics.h"
#include <stdlib.h>
#include <string.h>

static uint64_t seed = 1;

/* A cone of directions about w: no narrower than 'angle'. */
static Vec3 about(Vec3 w, double angle, Rng *rng)
{
    double x, y;
    rng_disk(rng, &x, &y);
    Vec3 a, b;
    frame(w, &a, &b);
    return normalize(along(along(w, angle * x, a), angle * y, b));
}

static void tell_cone(Emission *e, uint32_t material, Vec3 normal, Vec3 w, double angle, int n, Rng *rng)
{
    for (int i = 0; i < n; i++) {
        Vec3 d = about(w, angle, rng);
        emission_see(e, material, d, dot(d, normal));
    }
}

/* Cells of the square to which the sphere unrolls, finer about a place of it. */
enum { ACROSS = 12, CELLS = 2 * ACROSS * ACROSS };
typedef struct { double low[2], size[2]; } Window;

static int cell_of(Vec3 w, const Window *fine)
{
    double turns = atan2(w.y, w.x) / (2 * PI), at[2] = { (1 + w.z) / 2, turns < 0 ? turns + 1 : turns }, in[2];
    for (int i = 0; i < 2; i++) in[i] = (at[i] - fine->low[i]) / fine->size[i];
    bool inside = in[0] >= 0 && in[0] < 1 && in[1] >= 0 && in[1] < 1;
    for (int i = 0; i < 2; i++) if (!inside) in[i] = fmin(at[i], 1 - 1e-9);
    return (inside ? ACROSS * ACROSS : 0) + (int)(in[0] * ACROSS) * ACROSS + (int)(in[1] * ACROSS);
}

/* What is drawn above the surface against the density told, summed by the cosine law's own directions times the ratio: a chi-square of both counts. 'fault': 1 tells
 * the cosine law; 2 tells another lamp's density. */
static double densities_apart(const Emission *e, uint32_t root, uint32_t told, Vec3 normal, const Window *fine, int fault)
{
    enum { N = 400000 };
    double drawn[CELLS] = { 0 }, sum[CELLS] = { 0 }, square[CELLS] = { 0 }, chi_square = 0;
    int freedom = 0;
    Rng rng = rng_new(seed, 3);
    for (int i = 0; i < N; i++) {
        Vec3 w = emission_sample(e, root, normal, &rng);
        if (dot(w, normal) > 0) drawn[cell_of(w, fine)]++;
        /* half of them uniform in the window, where the cosine law has few */
        bool in_window = i % 2 == 0;
        double z = 2 * (fine->low[0] + fine->size[0] * rng_double(&rng)) - 1, phi = 2 * PI * (fine->low[1] + fine->size[1] * rng_double(&rng)), r = sqrt(1 - z * z);
        w = in_window ? vec3(r * cos(phi), r * sin(phi), z) : sample_cosine(normal, &rng);
        double cosine = dot(w, normal);
        if (!(cosine > 0)) continue;
        int cell = cell_of(w, fine);
        if (!in_window && cell >= ACROSS * ACROSS) continue;
        double pdf = cosine / PI * (fault == 1 ? 1 : emission_ratio(e, fault == 2 ? told : root, w, cosine));
        double value = 2 * (in_window ? pdf * 4 * PI * fine->size[0] * fine->size[1] : pdf / (cosine / PI));
        sum[cell] += value;
        square[cell] += value * value;
    }
    for (int i = 0; i < CELLS; i++) {
        if (drawn[i] < 20 && sum[i] < 20) continue;
        chi_square += pow(drawn[i] - sum[i], 2) / (drawn[i] + fmax(0, square[i] - sum[i] * sum[i] / N) + 1e-9);
        freedom++;
    }
    return freedom > 20 ? chi_square_deviate(chi_square, freedom) : NAN;
}

static void test_densities(void)
{
    Emission *e = calloc(1, sizeof *e);
    if (!CHECK(e)) return;
    Rng rng = rng_new(seed, 1);
    Vec3 down = vec3(0, -1, 0), aside = normalize(vec3(0.3, -0.8, 0.5)), up = vec3(0, 0.6, 0.8), grazing = normalize(vec3(0.95, 0.62, 0.8));
    tell_cone(e, 7, down, aside, 0.05, 20000, &rng);
    tell_cone(e, 2, up, grazing, 0.3, 20000, &rng);
    emission_learn(e);
    uint32_t one = emission_root(e, 7), other = emission_root(e, 2);
    CHECK(one > 0 && other > 0 && one != other && emission_root(e, 5) == 0 && emission_active(e));
    const struct { uint32_t root, told; Vec3 normal; Window fine; } list[] = {
        { one, other, down, { { 0.71, 0.79 }, { 0.08, 0.08 } } },
        { other, one, up, { { 0.6, 0 }, { 0.3, 0.3 } } },
    };
    for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
        double right = densities_apart(e, list[i].root, 0, list[i].normal, &list[i].fine, 0);
        double cosine = densities_apart(e, list[i].root, 0, list[i].normal, &list[i].fine, 1);
        double wrong = densities_apart(e, list[i].root, list[i].told, list[i].normal, &list[i].fine, 2);
        printf("drawn against told: deviate %.2f; planted: cosine law %.1f, another lamp's %.1f\n", right, cosine, wrong);
        CHECK(right < 4.5);
        CHECK(cosine > 20);
        CHECK(wrong > 20);
    }
    CHECK(emission_ratio(e, one, aside, dot(aside, down)) > 50);
    Vec3 elsewhere = normalize(vec3(-0.3, -0.8, 0.5));
    CHECK_NEAR(emission_ratio(e, one, elsewhere, dot(elsewhere, down)), 0.5, 1e-12);
    free(e);
}

/* By the cosine law, so often; what is learned of it. */
static bool learns_cosine(int n, bool same_again)
{
    Emission *e = calloc(1, sizeof *e);
    if (!CHECK(e)) return false;
    Rng rng = rng_new(seed, 2);
    Vec3 normal = normalize(vec3(1, 2, -3)), w = normal;
    for (int i = 0; i < n; i++) {
        if (!same_again || i % 1000 == 0) w = sample_cosine(normal, &rng);
        emission_see(e, 0, w, dot(w, normal));
    }
    if (same_again) CHECK(e->told == (uint64_t)(n + 999) / 1000);
    emission_learn(e);
    bool learned = emission_active(e);
    free(e);
    return learned;
}

/* Many are told of a cone that moves: the first and the last count alike, however many have to be left out. */
static void test_many(void)
{
    Emission *e = calloc(1, sizeof *e);
    if (!CHECK(e)) return;
    Rng rng = rng_new(seed, 4);
    Vec3 normal = vec3(0, 0, 1), first = normalize(vec3(1, 0, 1)), last = normalize(vec3(-1, 1, 1));
    for (int i = 0; i < 2; i++) {
        tell_cone(e, 0, normal, i ? last : first, 0.02, 100000, &rng);
        emission_learn(e);             /* which must not spoil what is kept */
    }
    CHECK(e->kept <= EMISSION_KEPT && e->kept >= EMISSION_KEPT / 2);
    double near_first = 0, near_last = 0;
    for (int i = 0; i < 100000; i++) {
        Vec3 w = emission_sample(e, emission_root(e, 0), normal, &rng);
        near_first += dot(w, first) > cos(0.03);
        near_last += dot(w, last) > cos(0.03);
    }
    printf("of directions drawn, near the first cone %.3f, near the last %.3f\n", near_first / 1e5, near_last / 1e5);
    CHECK(near_first > 20000 && near_last > 20000 && fabs(near_first - near_last) < 1500);
    for (uint32_t material = 1; material < 2 * EMISSION_LAMPS; material++) tell_cone(e, material, normal, first, 0.02, 100, &rng);
    emission_learn(e);
    CHECK(e->lamps == EMISSION_LAMPS && e->nodes <= EMISSION_NODES);
    CHECK(emission_root(e, 2 * EMISSION_LAMPS - 1) == 0);
    free(e);
}

int main(int argc, char **argv)
{
    if (argc > 1) seed = strtoull(argv[1], NULL, 10);
    test_densities();
    CHECK(!learns_cosine(100, false));
    CHECK(!learns_cosine(1000, false));
    CHECK(!learns_cosine(100000, false));
    CHECK(!learns_cosine(100000, true));
    test_many();
    return check_report();
}
