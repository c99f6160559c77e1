/* Acceptance ratios against a slow evaluation of f and T in full product area measure (reference.h):
 *
 *   R(y|x) = f(y)/T(y|x),  R(x|y) = f(x)/T(x|y)  and  f(x) T(y|x) a(y|x) = f(y) T(x|y) a(x|y)          [lecture: detailed balance]
 *
 * over more than a million proposals of every mutation in every scene, from chains that move through path space; the collapse of the acceptance
 * under the importance p_d2; the slides' tables; the slides' Examples 1 and 2 term by term; cached terms against fresh ones; and that proposals
 * are distributed as T says. Every comparison is also shown faults that it must see. Fixed seeds, nothing is tried twice. Run from the project's root.
 *
 *     test_ratio [FACTOR]               FACTOR times the proposals in every scene, for a long run
 */
#include "check.h"
#include "fresh.h"
#include "reference.h"
#include "mlt.h"
#include "statistics.h"
#include <stdlib.h>
#include <time.h>

enum { MAX_DEPTH = 16, WORK_PATHS = 3 };

static const char *const scene_path[] = {
    "scenes/cornell.obj", "scenes/caustic.obj", "scenes/door.obj", "scenes/furnace.obj", "scenes/glossy.obj", "scenes/pool.obj",
    "test/scenes/blind.obj", "test/scenes/dark.obj", "test/scenes/direct.obj", "test/scenes/lens-dof.obj", "test/scenes/mirror-smooth.obj",
    "test/scenes/narrow.obj", "test/scenes/texture.obj", "test/scenes/underwater.obj", "test/scenes/water-smooth.obj",
};
enum { SCENES = sizeof scene_path / sizeof scene_path[0] };

/* too large for the stack */
static Path path_store[WORK_PATHS];
static RefPath ref_store[4];

/* ---- one proposal against the reference ---- */

typedef struct { Real R_yx, R_xy, T_yx, T_xy; } RefMove;

/* R as the rows define it: full f/T with the factors left out that x and y share, and, in perturbations, the density of the step. T is full. */
static RefMove reference_move(const Space *space, const Tuning *tuning, const char *row, const Path *px, const Path *py, const RefPath *x, const RefPath *y,
                              const Move *move, Fault fault)
{
    RefMove r = { 0 };
    if (strcmp(row, "bidir") == 0) {
        int s = move->s;
        r.T_yx = ref_T_bidir(tuning, space->max_depth, px, x, py, y, s, move->k_d, move->k_a, fault);
        r.T_xy = ref_T_bidir(tuning, space->max_depth, py, y, px, x, s, move->k_a, move->k_d, fault);
        r.R_yx = y->chi * ref_segment(y, s, s + move->k_a) / r.T_yx;
        r.R_xy = x->chi * ref_segment(x, s, s + move->k_d) / r.T_xy;
        return r;
    }
    Real kernel_yx, kernel_xy;
    int m;
    if (strcmp(row, "caustic") == 0) {
        m = ref_caustic_suffix(px);
        r.T_yx = ref_T_caustic(tuning, x, y, m, fault, &kernel_yx);
        r.T_xy = ref_T_caustic(tuning, y, x, m, fault, &kernel_xy);
        r.R_yx = y->chi * ref_segment(y, m, y->k) / r.T_yx;
        r.R_xy = x->chi * ref_segment(x, m, x->k) / r.T_xy;
    } else {
        bool drawn = strcmp(row, "subpath") == 0;
        m = ref_lens_suffix(px, row);
        r.T_yx = ref_T_lens(space, tuning, x, y, m, drawn, fault, &kernel_yx);
        r.T_xy = ref_T_lens(space, tuning, y, x, m, drawn, fault, &kernel_xy);
        r.R_yx = y->chi * ref_segment(y, m - 1, y->k) / r.T_yx;
        r.R_xy = x->chi * ref_segment(x, m - 1, x->k) / r.T_xy;
    }
    r.T_yx *= kernel_yx;
    r.T_xy *= kernel_xy;
    return r;
}

/* Worst relative differences */
typedef struct {
    uint64_t proposals, accepted;
    double R, ratio, balance;          /* R(y|x), R(x|y); their quotient; flows */
    double collapse;                   /* the acceptance under the pure importance p_d2, by w alone */
    double cache, fresh;               /* reference against cached chi; caches against path_evaluate */
    double parts;                      /* p_d1, p_d2, p_a1, p_a2, routes of the bidirectional Move */
    uint64_t wrong;                    /* things that may not happen at all */
    char note[200];
} Worst;

/* How far light leaves a vertex off the mirror image. */
static Real off_mirrored(const Path *p, const RefPath *r, int i)
{
    Vec3 n = p->v[i].point.surface.ns, lens = r->v[i].to_lens, light = neg(r->v[i - 1].to_lens);
    return ref_angle(sub(scale(2 * dot(lens, n), n), lens), light);
}

/* By how much that may be off: rays leave their surfaces by up to 2^-21 (scene.c), which turns the edges between the recorded points a little. */
static double turn_slack(const RefPath *r, int i) { return 0x1p-19 * (double)(sqrtl(r->v[i - 1].inv_d2) + sqrtl(r->v[i].inv_d2)); }

static void compare(const Space *space, const Sampler *sampler, const char *row, const Path *px, const Path *py, const Move *move, Worst *worst)
{
    RefPath *x = &ref_store[0], *y = &ref_store[1];
    const Tuning *tuning = &sampler->tuning;
    ref_path(space, px, FAULT_NONE, x);
    ref_path(space, py, FAULT_NONE, y);
    RefMove r = reference_move(space, tuning, row, px, py, x, y, move, FAULT_NONE);
    double a_yx = fmin(1, move->R_yx / move->R_xy), a_xy = fmin(1, move->R_xy / move->R_yx), before = worst->R;
    worst->proposals++;
    check_worse(&worst->R, relative(r.R_yx, move->R_yx));
    check_worse(&worst->R, relative(r.R_xy, move->R_xy));
    check_worse(&worst->ratio, relative(r.R_yx / r.R_xy, (Real)move->R_yx / move->R_xy));
    check_worse(&worst->balance, relative(x->target * r.T_yx * a_yx, y->target * r.T_xy * a_xy));
    check_worse(&worst->cache, relative(y->chi, py->chi));
    if (worst->R > before)
        snprintf(worst->note, sizeof worst->note, "%s: k %d -> %d, s %d, k_d %d, k_a %d, j %d: R(y|x) %.9g for %.9Lg, R(x|y) %.9g for %.9Lg", row, px->k, py->k,
                 move->s, move->k_d, move->k_a, move->j, move->R_yx, r.R_yx, move->R_xy, r.R_xy);
    if (strcmp(row, "bidir") == 0) {
        int s = move->s, t = move->t, u = s + move->k_a;
        worst->wrong += t - s != move->k_d || py->k != px->k - move->k_d + move->k_a;
        check_worse(&worst->parts, relative(ref_p_d1(px->k, move->k_d, FAULT_NONE), move->p_d1_x));
        check_worse(&worst->parts, relative(ref_p_d1(py->k, move->k_a, FAULT_NONE), move->p_d1_y));
        check_worse(&worst->parts, relative(ref_p_a1(px->k, move->k_d, move->k_a, space->max_depth, FAULT_NONE), move->p_a1_x));
        check_worse(&worst->parts, relative(ref_p_a1(py->k, move->k_a, move->k_d, space->max_depth, FAULT_NONE), move->p_a1_y));
        check_worse(&worst->parts, relative(ref_p_d2(tuning, px, x, s, t), move->p_d2_x));
        check_worse(&worst->parts, relative(ref_p_d2(tuning, py, y, s, u), move->p_d2_y));
        check_worse(&worst->parts, relative(ref_w(px, x, s, t), bidir_w(px, s, t)));
        int ways_x = 0, ways_y = 0;
        for (int j = 0; j < move->k_d; j++) ways_x += ref_possible(px, s, t, j);
        for (int j = 0; j < move->k_a; j++) ways_y += ref_possible(py, s, u, j);
        worst->wrong += bidir_ways(px, s, t, move->k_d - 1) != ways_x || bidir_ways(py, s, u, move->k_a - 1) != ways_y
                      || !ref_possible(py, s, u, move->j) || relative(move->p_a2_x, 1 / (Real)ways_y) > 1e-12
                      || relative(move->p_a2_y, 1 / (Real)ways_x) > 1e-12;
        check_worse(&worst->parts, relative(ref_w(py, y, s, u) * ways_y, move->routes_y));
        check_worse(&worst->parts, relative(ref_w(px, x, s, t) * ways_x, move->routes_x));
        if (tuning->p_d2_importance == 1) {
            /* every w cancels but the sums: a = [chi_y W_x(k_d) p_d1^y(k_a) p_a1^y(k_d)] / [chi_x W_y(k_a) p_d1^x(k_d) p_a1^x(k_a)] */
            Real W_x = 0, W_y = 0;
            for (int a = -1; a + move->k_d <= px->k + 1; a++) W_x += (Real)bidir_w(px, a, a + move->k_d) * (a < 0 ? tuning->light_scale : 1);
            for (int a = -1; a + move->k_a <= py->k + 1; a++) W_y += (Real)bidir_w(py, a, a + move->k_a) * (a < 0 ? tuning->light_scale : 1);
            Real top = py->chi * W_x * ref_p_d1(py->k, move->k_a, FAULT_NONE) * ref_p_a1(py->k, move->k_a, move->k_d, space->max_depth, FAULT_NONE);
            Real bottom = px->chi * W_y * ref_p_d1(px->k, move->k_d, FAULT_NONE) * ref_p_a1(px->k, move->k_d, move->k_a, space->max_depth, FAULT_NONE);
            check_worse(&worst->collapse, relative(top / bottom, (Real)move->R_yx / move->R_xy));
        }
    } else if (strcmp(row, "subpath") != 0) {
        double dx = x->raster_x - y->raster_x, dy = x->raster_y - y->raster_y, r_film = sqrt(dx * dx + dy * dy);
        int m = strcmp(row, "caustic") == 0 ? ref_caustic_suffix(px) : 0;
        /* rays leave their surfaces by up to 2^-21 (scene.c), which turns the edge between the recorded points a little */
        double theta = (double)ref_angle(x->v[m].to_lens, y->v[m].to_lens), slack = 1e-6;
        double turn = 0x1p-20 * (double)(sqrtl(x->v[m].inv_d2) + sqrtl(y->v[m].inv_d2));
        worst->wrong += px->k != py->k;
        if (strcmp(row, "caustic") == 0) worst->wrong += theta < tuning->theta2 * exp(tuning->log_theta) - turn || theta > tuning->theta2 + turn;
        else worst->wrong += r_film < tuning->r2 * exp(tuning->log_r) * (1 - slack) - 1e-9 || r_film > tuning->r2 * (1 + slack);
        for (int i = 1; i < px->k; i++) worst->wrong += px->v[i].mode != py->v[i].mode;      /* copied modes */
        for (int i = 1; i < px->k; i++) {      /* copied places in narrow lobes; from y the move must be possible, too */
            bool towards_lens = strcmp(row, "caustic") == 0, moved = towards_lens ? i > m : i > move->first;
            if (moved) worst->wrong += x->v[i].s.narrow != y->v[i].s.narrow;
            if (!moved || !x->v[i].s.narrow) continue;
            double off = fabs((double)(off_mirrored(px, x, i) - off_mirrored(py, y, i)));
            worst->wrong += off > turn_slack(x, i) + turn_slack(y, i);
        }
        worst->wrong += strcmp(row, "caustic") == 0 ? ref_caustic_suffix(py) != m : ref_lens_suffix(py, row) != move->first;
    }
}

/* Chains of 'steps' proposals from seeds, until 'proposals' have been compared; the rows of the table in turn. The chain need only move, so
 * no probabilities of choosing rows enter. worst[MUTATIONS] */
static void run_chains(const Space *space, const Sampler *sampler, const Bootstrap *boot, Bdpt *bdpt, uint64_t proposals, uint64_t seed, Worst *worst)
{
    Path *x = &path_store[0], *y = &path_store[1];
    Rng rng = rng_new(seed, 77);
    uint64_t compared = 0, steps = 0;
    enum { CHAIN = 400 };
    for (uint64_t chain = 0; compared < proposals && steps < 40 * proposals; chain++) {
        if (!bootstrap_seed(boot, space, bdpt, even(0.37, chain + seed, 0), x) || !(x->chi > 0)) { worst[0].wrong++; steps++; continue; }
        for (int i = 0; i < CHAIN; i++, steps++) {
            int row = (int)rng_index(&rng, (uint32_t)sampler->rows);
            if (!(sampler->share[row] > 0) || !sampler->table[row].applies(space, x)) continue;
            if (strcmp(sampler->table[row].name, "manifold") == 0) continue;   /* by differences, to another tolerance: test_explain.sh */
            Move move = { 0 };
            if (sampler->table[row].propose(space, &sampler->tuning, x, y, &rng, &move) != PROPOSED) continue;
            compare(space, sampler, sampler->table[row].name, x, y, &move, &worst[row]);
            compared++;
            double a = move.R_yx / move.R_xy;
            if (move.joined >= 0 && !scene_visible(space->scene, &y->v[move.joined].point, &y->v[move.joined + 1].point)) continue;
            if (rng_double(&rng) >= a) continue;
            worst[row].accepted++;
            path_copy(x, y);
            check_worse(&worst[row].fresh, fresh_difference(space, x, &path_store[2]));
        }
    }
}

/* ---- a scene with its samples ---- */

typedef struct {
    const char *name;
    Scene scene;
    Space space;
    Bdpt *bdpt;
    Bootstrap boot;
    Sampler sampler;
    Pixel *film;
    bool lit;
} Stage;

static bool stage_open(Stage *stage, const char *path, DirectClass direct, bool weighted, uint64_t samples)
{
    Report report = { 0 };
    CameraSettings none = { 0 };
    *stage = (Stage){ .name = path };
    if (!CHECK(scene_load(&stage->scene, path, &none, BVH_FAST, &report))) return false;
    stage->space = (Space){ .scene = &stage->scene, .max_depth = MAX_DEPTH, .direct = direct };
    if (weighted) {            /* any positive numbers will do: a two-stage weight */
        size_t n = (size_t)stage->scene.camera.width * stage->scene.camera.height;
        stage->film = calloc(n, sizeof *stage->film);
        Rng rng = rng_new(9, 9);
        for (size_t i = 0; i < n; i++) stage->film[i].weight = (float)(0.5 + 2 * rng_double(&rng));
        stage->space.film = stage->film;
    }
    stage->bdpt = bdpt_new();
    stage->sampler = sampler_for(&stage->scene, 31);
    stage->lit = stage->scene.n_lights > 0 && bootstrap_run(&stage->boot, &stage->space, stage->bdpt, samples, 5, 1) && stage->boot.b > 0;
    return true;
}

static void stage_close(Stage *stage)
{
    if (stage->boot.sum) bootstrap_free(&stage->boot);
    bdpt_free(stage->bdpt);
    free(stage->film);
    scene_free(&stage->scene);
}

static void test_power(const Scene *scene)
{
    const Mesh *m = &scene->mesh;
    Real power = 0;
    for (uint32_t i = 0; i < m->n_triangles; i++) {
        Vec3 c[3];
        for (int j = 0; j < 3; j++) c[j] = from_float(m->position[m->triangle[i][j]]);
        Vec3 n = cross(sub(c[1], c[0]), sub(c[2], c[0]));
        power += max3(m->material[m->triangle_material[i]].ke) * sqrtl(ref_dot(n, n)) / 2;
    }
    CHECK_NEAR(relative(power, scene->power), 0, 1e-12);
}

/* Agreement that rounding allows. R, and flows */
static const double TOLERANCE = 1e-6;

static double seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }

static void test_scenes(uint64_t per_scene)
{
    uint64_t all = 0;
    double all_R = 0;
    printf("%-14s %-8s %9s %9s %9s %9s %9s %9s %9s %9s\n", "scene", "row", "proposals", "R", "R/R", "balance", "collapse", "parts", "chi", "caches");
    for (int n = 0; n < SCENES; n++) {
        Worst worst[MUTATIONS] = { 0 };
        /* the space with and without direct light, the latter with weights on the film */
        for (int pass = 0; pass < 2; pass++) {
            Stage stage;
            if (!stage_open(&stage, scene_path[n], pass ? DIRECT_INCLUDED : DIRECT_EXCLUDED, !pass, 6000)) continue;
            /* nothing is lit in two scenes, and in one, a lamp over a sheet, nothing but directly */
            CHECK(stage.lit == !(strstr(scene_path[n], "blind") || strstr(scene_path[n], "dark") || (!pass && strstr(scene_path[n], "texture"))));
            if (pass == 0) test_power(&stage.scene);
            static const double importance[3] = { 0, 0.5, 1 };
            for (int i = 0; i < 3 && stage.lit; i++) {
                stage.sampler.tuning.p_d2_importance = importance[i];
                stage.sampler.tuning.light_scale *= i == 1 ? 0.3 : 1;  /* any constant is exact */
                run_chains(&stage.space, &stage.sampler, &stage.boot, stage.bdpt, per_scene / 6, 100 + (uint64_t)i, worst);
            }
            stage_close(&stage);
        }
        const char *slash = strrchr(scene_path[n], '/');
        for (int row = 0; row < MUTATIONS; row++) {
            const Worst *w = &worst[row];
            all += w->proposals;
            check_worse(&all_R, w->R);
            if (w->proposals == 0 && w->wrong == 0) continue;
            printf("%-14s %-8s %9llu %9.1e %9.1e %9.1e %9.1e %9.1e %9.1e %9.1e\n", slash + 1, mutation_table[row].name,
                   (unsigned long long)w->proposals, w->R, w->ratio, w->balance, w->collapse, w->parts, w->cache, w->fresh);
            int ok = CHECK(w->R <= TOLERANCE) & CHECK(w->ratio <= TOLERANCE) & CHECK(w->balance <= TOLERANCE) & CHECK(w->collapse <= 1e-12)
                   & CHECK(w->parts <= TOLERANCE) & CHECK(w->cache <= TOLERANCE) & CHECK(w->fresh <= 1e-12) & CHECK(w->wrong == 0);
            if (!ok) printf("  wrong %llu; %s\n", (unsigned long long)w->wrong, w->note);
        }
    }
    printf("%llu proposals compared, R off by at most %.1e\n", (unsigned long long)all, all_R);
    CHECK(all >= 1000000);
}

/* ---- faulty rows: the comparison must see them ---- */

/* A table whose rows propose as the real ones do, and then say R with a fault in it. */
static Fault planted;                  /* which; set by test_faults only */

static Outcome faulty(int row, const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    Outcome outcome = mutation_table[row].propose(space, tuning, x, y, rng, move);
    if (outcome != PROPOSED) return outcome;
    const char *name = mutation_table[row].name;
    ref_path(space, x, FAULT_NONE, &ref_store[0]);
    ref_path(space, y, FAULT_NONE, &ref_store[1]);
    ref_path(space, x, planted, &ref_store[2]);
    ref_path(space, y, planted, &ref_store[3]);
    RefMove right = reference_move(space, tuning, name, x, y, &ref_store[0], &ref_store[1], move, FAULT_NONE);
    RefMove wrong = reference_move(space, tuning, name, x, y, &ref_store[2], &ref_store[3], move, planted);
    move->R_yx *= (double)(wrong.R_yx / right.R_yx);
    move->R_xy *= (double)(wrong.R_xy / right.R_xy);
    return outcome;
}
static Outcome faulty_bidir(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return faulty(0, s, t, x, y, r, m); }
static Outcome faulty_lens(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return faulty(1, s, t, x, y, r, m); }
static Outcome faulty_caustic(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return faulty(2, s, t, x, y, r, m); }
static Outcome faulty_chain(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return faulty(3, s, t, x, y, r, m); }
static Outcome faulty_subpath(const Space *s, const Tuning *t, const Path *x, Path *y, Rng *r, Move *m) { return faulty(4, s, t, x, y, r, m); }

static void test_faults(void)
{
    static const struct { Fault fault; int row; const char *scene; double p_d2; } plant[] = {
        { FAULT_WAY_LEFT_OUT, 0, "scenes/cornell.obj", 0.5 },
        { FAULT_WRONG_G, 0, "scenes/cornell.obj", 0.5 },
        { FAULT_TABLES, 0, "scenes/cornell.obj", 0.5 },
        { FAULT_NO_P_D2, 0, "scenes/cornell.obj", 1 },         /* a uniform p_d2 cancels: k - k_d = k' - k_a */
        { FAULT_DRAWN_AS_COPIED, 0, "test/scenes/water-smooth.obj", 0.5 },
        { FAULT_DRAWN_AS_COPIED, 4, "scenes/pool.obj", 0.5 },
        { FAULT_COPIED_AS_DRAWN, 1, "test/scenes/water-smooth.obj", 0.5 },
        { FAULT_COPIED_AS_DRAWN, 2, "scenes/caustic.obj", 0.5 },
        { FAULT_COPIED_AS_DRAWN, 3, "scenes/pool.obj", 0.5 },
        { FAULT_NO_COSINE, 2, "scenes/caustic.obj", 0.5 },
        { FAULT_NO_COSINE, 3, "scenes/pool.obj", 0.5 },
        { FAULT_NO_COSINE, 1, "test/scenes/narrow.obj", 0.5 },
        { FAULT_NO_COSINE, 2, "test/scenes/narrow.obj", 0.5 },
        { FAULT_NO_COSINE, 3, "test/scenes/narrow.obj", 0.5 },
        { FAULT_NO_ETA, 0, "test/scenes/underwater.obj", 0.5 },
        { FAULT_NO_NORMALS, 0, "test/scenes/water-smooth.obj", 0.5 },
        { FAULT_NO_NORMALS, 0, "test/scenes/mirror-smooth.obj", 0.5 },
        { FAULT_NO_NORMALS, 2, "test/scenes/mirror-smooth.obj", 0.5 },
    };
    Mutation table[MUTATIONS];
    memcpy(table, mutation_table, sizeof table);
    table[0].propose = faulty_bidir;
    table[1].propose = faulty_lens;
    table[2].propose = faulty_caustic;
    table[3].propose = faulty_chain;
    table[4].propose = faulty_subpath;
    for (size_t i = 0; i < sizeof plant / sizeof plant[0]; i++) {
        Stage stage;
        if (!stage_open(&stage, plant[i].scene, DIRECT_EXCLUDED, false, 3000)) continue;
        stage.sampler.tuning.p_d2_importance = plant[i].p_d2;
        Sampler sampler = stage.sampler;
        sampler.table = table;
        Worst worst[MUTATIONS] = { 0 };
        planted = plant[i].fault;
        run_chains(&stage.space, &sampler, &stage.boot, stage.bdpt, 2000, 7, worst);
        const Worst *w = &worst[plant[i].row];
        printf("planted: %-28s in %-8s %-30s seen as %.2g over %llu proposals\n", fault_name[planted], table[plant[i].row].name, plant[i].scene, w->balance,
               (unsigned long long)w->proposals);
        CHECK(w->balance > 1000 * TOLERANCE);
        stage_close(&stage);
    }
}

/* ---- the slides' tables, and the ways ---- */

static void test_tables(void)
{
    /* [lecture: Probabilities]: 1/4, 1/2, 1/8, 1/16 ..; the cut at k+2 leaves 1 - 2^-(k+2) of it */
    static const double slide_d1[] = { 0.25, 0.5, 0.125, 0.0625, 0.03125 };
    double worst = 0;
    for (int k = 1; k <= MAX_EDGES; k++) {
        double sum = 0, rest = 1 - exp2(-(k + 2));
        for (int e = 1; e <= k + 2; e++) {
            double p = bidir_p_d1(k, e);
            sum += p;
            check_worse(&worst, relative(p, ref_p_d1(k, e, FAULT_NONE)));
            if (e <= 5) check_worse(&worst, relative(p, slide_d1[e - 1] / rest));
        }
        check_worse(&worst, fabs(sum - 1));
    }
    CHECK_NEAR(worst, 0, 1e-14);
    /* [lecture: Probabilities (2)]: 1/2 for the deleted length, 0.15 beside it */
    worst = 0;
    for (int depth = 1; depth <= 20; depth++)
        for (int k = 1; k <= depth; k++)
            for (int k_d = 1; k_d <= k + 2; k_d++) {
                double sum = 0, p[64] = { 0 };
                for (int k_a = 1; k_a < 64; k_a++) {
                    p[k_a] = bidir_p_a1(k, k_d, k_a, depth);
                    int new_k = k - k_d + k_a;
                    if (new_k < 1 || new_k > depth) check_worse(&worst, p[k_a]);
                    sum += p[k_a];
                    check_worse(&worst, relative(p[k_a], ref_p_a1(k, k_d, k_a, depth, FAULT_NONE)));
                }
                check_worse(&worst, fabs(sum - 1));
                /* 0.5 : 0.15 wherever both are possible */
                if (p[k_d] > 0 && p[k_d + 1] > 0) check_worse(&worst, relative(p[k_d] / p[k_d + 1], 0.5 / 0.15));
                if (p[k_d] > 0 && p[k_d - 1] > 0) check_worse(&worst, relative(p[k_d] / p[k_d - 1], 0.5 / 0.15));
            }
    CHECK_NEAR(worst, 0, 1e-13);
    /* far from both cuts nothing is lost: 1/2 + 2 * 0.15 + 2 * 0.1 * (1/2 + 1/4 + ..) = 1 */
    CHECK_NEAR(bidir_p_a1(200, 60, 60, 255), 0.5, 1e-12);
    CHECK_NEAR(bidir_p_a1(200, 60, 61, 255), 0.15, 1e-12);
    CHECK_NEAR(bidir_p_a1(200, 60, 59, 255), 0.15, 1e-12);
    CHECK_NEAR(bidir_p_a1(200, 60, 62, 255), 0.05, 1e-12);
    /* planted: the tables as they stand on the slides do not sum to 1 */
    double sum = 0;
    for (int e = 1; e <= 4; e++) sum += (double)ref_p_d1(2, e, FAULT_TABLES);
    CHECK(fabs(sum - 1) > 0.01);
}

/* Ways, for every pattern of specular and other vertices of short paths, by enumeration: who grows what, and what would be joined. */
static void test_ways(void)
{
    Material grey = { .kind = MATERIAL_DIFFUSE, .kd = { 0.5, 0.5, 0.5 } }, mirror = { .kind = MATERIAL_MIRROR, .ks = { 1, 1, 1 } };
    Material lamp = { .kind = MATERIAL_DIFFUSE, .ke = { 1, 1, 1 } }, lamp_mirror = { .kind = MATERIAL_MIRROR, .ks = { 1, 1, 1 }, .ke = { 1, 1, 1 } };
    const Material *kind[4] = { &grey, &mirror, &lamp, &lamp_mirror };
    int wrong = 0, tested = 0;
    Path *z = &path_store[0];
    for (int k = 1; k <= 4; k++)
        for (int pattern = 0; pattern < 1 << (2 * k); pattern++) {
            z->k = k;
            for (int i = 0; i < k; i++) {
                z->v[i].point = (Point){ .surface = { .material = kind[pattern >> (2 * i) & 3] } };
                z->v[i].mode = i > 0 && material_is_specular(z->v[i].point.surface.material) ? MODE_REFLECT : MODE_NONE;
            }
            z->v[k].point = (Point){ .triangle = BVH_NONE };
            z->v[k].mode = MODE_NONE;
            for (int s = -1; s <= k; s++)
                for (int t = s + 1; t <= k + 1; t++) {
                    int n = 0, m = t - s - 1;
                    for (int j = 0; j <= m; j++) n += ref_possible(z, s, t, j);
                    tested++;
                    wrong += bidir_ways(z, s, t, m) != n;
                }
        }
    CHECK(wrong == 0);
    CHECK(tested > 4000);
}

/* ---- the slides' examples, term by term, in the slides' notation ---- */

/* Lambert: f_s = kd/pi, its scalar the largest channel; p_s = 1/pi per projected solid angle */
static double lambert(const Path *p, int i) { return max3(p->v[i].point.surface.kd) / PI; }
static double G(const Path *p, int i)
{
    Vec3 d = sub(p->v[i + 1].point.p, p->v[i].point.p);
    return fabs(dot(d, p->v[i].point.surface.ng) * dot(d, p->v[i + 1].point.surface.ng)) / pow(dot(d, d), 2);
}
static double chi_of(const Path *p)
{
    Rgb ke = p->v[0].point.surface.material->ke, c = scale(1 / max3(ke), ke);
    for (int i = 1; i < p->k; i++) c = mul(c, scale(1 / max3(p->v[i].point.surface.kd), p->v[i].point.surface.kd));
    return luminance(c);
}

typedef struct { int found; double worst, slip_G; } Example;

/* F_0 = L_e */
static double light_end(const Path *p) { return max3(p->v[0].point.surface.material->ke); }

/* Example 1: x_0 x_1 x_2 x_3, s = 1, t = 2, s' = 1, t' = 0 */
static void example_1(const Tuning *tuning, const Scene *scene, int depth, const Path *x, const Path *y, const Move *move, Example *e)
{
    double p_s = 1 / PI;
    double f1 = lambert(y, 1), fz = lambert(y, 2), f2 = lambert(y, 3), numerator = f1 * G(y, 1) * fz * G(y, 2) * f2;
    double C_01z2 = f1 * G(y, 1) * fz, C_1z23 = fz * G(y, 2) * f2, C_0123 = f1 * G(x, 1) * f2;
    double S_01z = f1 / p_s, S_z23 = f2 / p_s;                                   /* the latter f_s(z0,x2,x3)/p<, not the slides' reversed S */
    check_worse(&e->worst, relative(1 / path_inv_C(y, 1), C_01z2));
    check_worse(&e->worst, relative(1 / path_inv_C(y, 2), C_1z23));
    check_worse(&e->worst, relative(1 / path_inv_C(x, 1), C_0123));
    check_worse(&e->worst, relative(1 / path_inv_S_lens(y, 1), S_01z));
    check_worse(&e->worst, relative(1 / path_inv_S_light(y, 3), S_z23));
    /* p_a1 for k = 3: forward k_d = 1, any k_a from 1 to depth - 2; back from k = 4, k_d = 2, k_a >= 1. p_a2 = 1/2 forward, 1 back */
    double sum_x = 0, sum_y = 0;
    for (int k_a = 1; k_a <= depth - 2; k_a++) sum_x += k_a == 1 ? 0.5 : k_a == 2 ? 0.15 : 0.1 * exp2(2 - k_a);
    for (int k_a = 1; k_a <= depth - 2; k_a++) sum_y += k_a == 2 ? 0.5 : k_a == 1 || k_a == 3 ? 0.15 : 0.1 * exp2(3 - k_a);
    double p_a_x = 0.15 / sum_x, p_a_y = 0.15 / sum_y;
    double U = p_a_x / 2 * p_s * G(y, 1) + p_a_x / 2 * p_s * G(y, 2);
    check_worse(&e->worst, relative(U / numerator, move->p_a1_x * move->p_a2_x * move->routes_y));
    /* p_d: the slides' 1/4 for one edge, 1/2 for two, cut at k+2; p_d2 = 1/C over the sum of 1/C, which for s = -1 is 1/L_e times a constant.
     * For two edges of y: one vertex regrown from either side, or, with s = -1, picked on a light or hit by chance, or seen from the lens. */
    double L = light_end(x), We = 1 / y->v[4].s.inv_F, We_x = 1 / x->v[3].s.inv_F, p_A = L / scene->power, c = tuning->light_scale;
    double w_x = 1 / C_0123, W_x = c / L + 1 / (L * G(x, 0) * f1) + w_x + 1 / (f2 * G(x, 2) * We_x), share = tuning->p_d2_importance;
    double l = light_end(y), w_y[4];
    w_y[0] = c * 0.5 * (p_s * G(y, 0) / (l * G(y, 0) * f1) + p_A / (l * G(y, 0) * f1));              /* x_0 hit from x_1; x_0 picked */
    w_y[1] = 0.5 * (p_s * G(y, 1) + p_s * G(y, 0)) / (l * G(y, 0) * f1 * G(y, 1) * fz);              /* x_1 from x_0, or from z */
    w_y[2] = 0.5 * (p_s * G(y, 1) + p_s * G(y, 2)) / numerator;                                       /* z from x_1, or from x_2: 1,3 */
    w_y[3] = 0.5 * (p_s * G(y, 2) + We * G(y, 3)) / (fz * G(y, 2) * f2 * G(y, 3) * We);              /* x_2 from z, or from the lens */
    /* s = 3, t = 5: the lens point alone is drawn, then joined: one way, C */
    double w_5 = 1 / (f2 * G(y, 3) * We);
    double W_y = w_y[0] + w_y[1] + w_y[2] + w_y[3] + w_5;
    double p_d_x = 0.25 / (1 - 0x1p-5) * ((1 - share) / 5 + share * w_x / W_x), p_d_y = 0.5 / (1 - 0x1p-6) * ((1 - share) / 5 + share * w_y[2] / W_y);
    check_worse(&e->worst, relative(p_d_x, move->p_d1_x * move->p_d2_x));
    check_worse(&e->worst, relative(p_d_y, move->p_d1_y * move->p_d2_y));
    double R_yx = chi_of(y) * numerator / (p_d_x * U), R_xy = chi_of(x) * C_0123 / (p_d_y * p_a_y);
    check_worse(&e->worst, relative(R_yx, move->R_yx));
    check_worse(&e->worst, relative(R_xy, move->R_xy));
    /* the slides' last line: K (A C/S + B C/S) under C C */
    double last = C_01z2 * C_1z23 / (p_d_x * (p_a_x / 2 * C_01z2 / S_01z + p_a_x / 2 * C_1z23 / S_z23));
    check_worse(&e->worst, relative(chi_of(y) * last, move->R_yx));
    /* planted: the slides' slip, G(x0,x1) for G(x1,z0) */
    double slip = p_a_x / 2 * p_s * G(y, 0) + p_a_x / 2 * p_s * G(y, 2);
    check_worse(&e->slip_G, relative(chi_of(y) * numerator / (p_d_x * slip), move->R_yx));
    e->found++;
}

/* Example 2: x_0 .. x_4, s = 1, t = 3, s' = 1, t' = 1: y = x_0 x_1 a b x_3 x_4. The slides end at 'numerator is ...'. */
static void example_2(const Path *x, const Path *y, const Move *move, Example *e)
{
    double p = 1 / PI;
    double numerator = lambert(y, 1) * G(y, 1) * lambert(y, 2) * G(y, 2) * lambert(y, 3) * G(y, 3) * lambert(y, 4);
    double back = lambert(x, 1) * G(x, 1) * lambert(x, 2) * G(x, 2) * lambert(x, 3);
    double way_20 = p * G(y, 1) * p * G(y, 2), way_11 = p * G(y, 1) * p * G(y, 3), way_02 = p * G(y, 3) * p * G(y, 2);
    double way_10 = p * G(x, 1), way_01 = p * G(x, 2);
    check_worse(&e->worst, relative(1 / path_inv_C(y, 2), lambert(y, 2) * G(y, 2) * lambert(y, 3)));
    check_worse(&e->worst, relative(1 / path_inv_S_lens(y, 1), lambert(y, 1) / p));
    check_worse(&e->worst, relative(1 / path_inv_S_light(y, 4), lambert(y, 4) / p));
    check_worse(&e->worst, relative(move->p_a2_x, 1.0L / 3));
    check_worse(&e->worst, relative(move->p_a2_y, 0.5));
    check_worse(&e->worst, relative(move->routes_y, (way_20 + way_11 + way_02) / numerator));
    check_worse(&e->worst, relative(move->routes_x, (way_10 + way_01) / back));
    double T_yx = move->p_d1_x * move->p_d2_x * move->p_a1_x / 3 * (way_20 + way_11 + way_02);
    double T_xy = move->p_d1_y * move->p_d2_y * move->p_a1_y / 2 * (way_10 + way_01);
    check_worse(&e->worst, relative(chi_of(y) * numerator / T_yx, move->R_yx));
    check_worse(&e->worst, relative(chi_of(x) * back / T_xy, move->R_xy));
    /* planted: only the route that was taken */
    check_worse(&e->slip_G, relative(chi_of(y) * numerator / (T_yx * way_11 / (way_20 + way_11 + way_02)), move->R_yx));
    e->found++;
}

static void test_examples(void)
{
    Stage stage;
    if (!stage_open(&stage, "scenes/cornell.obj", DIRECT_EXCLUDED, false, 20000)) return;
    Path *x = &path_store[0], *y = &path_store[1];
    Example one = { 0 }, two = { 0 };
    Rng rng = rng_new(4, 4);
    for (uint64_t i = 0; i < 400000 && (one.found < 300 || two.found < 300); i++) {
        if (i % 100 == 0) {
            do {} while (!bootstrap_seed(&stage.boot, &stage.space, stage.bdpt, rng_double(&rng), x) || (x->k != 3 && x->k != 4));
            stage.sampler.tuning.p_d2_importance = (double)(i / 100 % 3) / 2;
        }
        Move move = { 0 };
        if (bidir_propose(&stage.space, &stage.sampler.tuning, x, y, &rng, &move) != PROPOSED) continue;
        if (x->k == 3 && move.s == 1 && move.t == 2 && move.k_a == 2 && move.j == 1)
            example_1(&stage.sampler.tuning, &stage.scene, MAX_DEPTH, x, y, &move, &one);
        if (x->k == 4 && move.s == 1 && move.t == 3 && move.k_a == 3 && move.j == 1) example_2(x, y, &move, &two);
    }
    printf("example 1: %d proposals, worst %.2g; planted slip %.2g\nexample 2: %d proposals, worst %.2g; planted slip %.2g\n", one.found, one.worst, one.slip_G,
           two.found, two.worst, two.slip_G);
    CHECK(one.found >= 100);
    CHECK(two.found >= 100);
    CHECK_NEAR(one.worst, 0, 1e-10);
    CHECK_NEAR(two.worst, 0, 1e-10);
    CHECK(one.slip_G > 0.1);
    CHECK(two.slip_G > 0.1);
    stage_close(&stage);
}

/* ---- proposals are distributed as T says ---- */

/* Weighted counts in cells; 'n' draws in all, of which some fall in no cell. */
enum { CELLS = 128 };
typedef struct {
    double sum[CELLS], square[CELLS];
    double n;
} Histogram;

static void put(Histogram *h, int cell, double weight)
{
    if (cell < 0 || cell >= CELLS) return;
    h->sum[cell] += weight;
    h->square[cell] += weight * weight;
}

/* Chi-square of two independent histograms of the same distribution, as a normal deviate (Wilson and Hilferty). Thin cells are pooled. */
static double deviate(const Histogram *a, const Histogram *b)
{
    double chi2 = 0, pa = 0, pb = 0, va = 0, vb = 0;
    int df = 0;
    for (int i = 0; i <= CELLS; i++) {
        if (i < CELLS) {
            pa += a->sum[i] / a->n;
            pb += b->sum[i] / b->n;
            va += a->square[i] / (a->n * a->n);
            vb += b->square[i] / (b->n * b->n);
        }
        double p = (pa + pb) / 2;
        bool enough = p * a->n >= 25 && p * b->n >= 25 && va > 0 && vb > 0;
        if (!enough && i < CELLS) continue;
        if (!(va + vb > 0)) continue;
        chi2 += (pa - pb) * (pa - pb) / (va + vb);
        df++;
        pa = pb = va = vb = 0;
    }
    return df > 0 ? chi_square_deviate(chi2, df) : NAN;
}

/* Upper tail of 1e-9: some 40 such comparisons leave the family's false-alarm rate below 1e-7. */
static const double DEVIATE = 6;

/* The label (s, k-t, k_d, k_a), drawn or not, with probability p_d p_a1; j uniform over the possible. */
static double labels(const Stage *stage, const Path *x, uint64_t n, uint64_t seed, Fault fault)
{
    static Histogram seen;
    double grown[3][3] = { 0 };        /* [new vertices][j], inside a diffuse path, where every j is possible */
    seen = (Histogram){ .n = (double)n };
    enum { MOST = 4 };                 /* labels with k_d, k_a up to 4 apart; the rest in the last cell */
    Rng rng = rng_new(seed, 3);
    Path *y = &path_store[1];
    const Tuning *tuning = &stage->sampler.tuning;
    for (uint64_t i = 0; i < n; i++) {
        Move move = { .k_a = -1 };
        bidir_propose(&stage->space, tuning, x, y, &rng, &move);
        if (move.k_a >= 2 && move.k_a <= 3 && move.s >= 0 && move.t <= x->k) grown[move.k_a - 1][move.j]++;
        bool common = move.k_a >= 1 && move.k_d <= MOST && move.k_a <= MOST && move.s <= 5;
        put(&seen, common ? (move.s + 1) * 16 + (move.k_d - 1) * 4 + move.k_a - 1 : CELLS - 1, 1);
    }
    ref_path(&stage->space, x, FAULT_NONE, &ref_store[0]);
    double chi2 = 0, rest = 1;
    int df = 0;
    for (int c = 0; c < CELLS - 1; c++) {
        int s = c / 16 - 1, k_d = c / 4 % 4 + 1, k_a = c % 4 + 1;
        double p = 0;
        if (s <= 5 && s + k_d <= x->k + 1)
            p = (double)(ref_p_d1(x->k, k_d, FAULT_NONE) * ref_p_a1(x->k, k_d, k_a, stage->space.max_depth, FAULT_NONE)
                         * ref_p_d2(tuning, x, &ref_store[0], s, s + k_d));
        if (fault == FAULT_NO_P_D2 && p > 0)      /* planted: uniform where the importance was asked for */
            p = (double)(ref_p_d1(x->k, k_d, FAULT_NONE) * ref_p_a1(x->k, k_d, k_a, stage->space.max_depth, FAULT_NONE)) / (x->k + 3 - k_d);
        if (p * (double)n < 25) continue;
        rest -= p;
        double d = seen.sum[c] - p * (double)n;
        chi2 += d * d / (p * (double)n);
        df++;
        seen.sum[c] = 0;
    }
    for (int m = 1; m <= 2; m++) {
        double all = grown[m][0] + grown[m][1] + grown[m][2], p = 1 / (m + 1.0);
        CHECK(all > 1000);
        for (int j = 0; j <= m; j++) CHECK_NEAR(grown[m][j], p * all, DEVIATE * sqrt(all * p * (1 - p)));
    }
    double left = 0;
    for (int c = 0; c < CELLS; c++) left += seen.sum[c];
    if (rest * (double)n > 25) { chi2 += pow(left - rest * (double)n, 2) / (rest * (double)n); df++; }
    return chi_square_deviate(chi2, df - 1);
}

/* A label that replaces one vertex, x_i, between x_s = x_{i-1} and x_t = x_{i+1}: T = p_d p_a1 (p>(x_s) G + p<(x_t) G) / 2 per dA.
 * Integrated over cells of the film (i = k-1) or of directions at the light (i = 1), by rays from the lens or from the light that weigh
 * T over their own density. What is near the other neighbour is left out of both histograms: the weights are then bounded. */
static int one_vertex_cell(const Space *space, const Path *y, int i)
{
    const Camera *camera = &space->scene->camera;
    const Point *v = &y->v[i].point;
    Vec3 d = sub(v->p, y->v[i > 1 ? i - 1 : i + 1].point.p);
    if (dot(d, d) < 0.09) return -1;
    if (i > 1) {
        const Vec3 lens = y->v[y->k].point.p;
        double rx, ry;
        ref_film(camera, lens, normalize(sub(v->p, lens)), &rx, &ry);
        double column = floor(8 * rx / camera->width), row = floor(8 * ry / camera->height);
        return column < 0 || column > 7 || row < 0 || row > 7 ? -1 : (int)(column * 8 + row);
    }
    Vec3 a, b, w = normalize(sub(v->p, y->v[0].point.p)), n = y->v[0].point.surface.ng;
    frame(n, &a, &b);
    double phi = atan2(dot(w, b), dot(w, a)) / (2 * PI) + 0.5, c = dot(w, n);
    return (int)fmin(c * c * 8, 7) * 8 + (int)fmin(phi * 8, 7);
}

/* Deviates of the observed proposals from T, from T with one of its two ways left out, and from T with the G of the wrong edge. */
enum { TOLD = 3 };
static void one_vertex(const Stage *stage, const Path *x, int i, uint64_t n, uint64_t seed, double out[TOLD])
{
    static Histogram seen, told[TOLD];
    seen = told[0] = told[1] = told[2] = (Histogram){ .n = (double)n };
    const Space *space = &stage->space;
    const Scene *scene = space->scene;
    const Tuning *tuning = &stage->sampler.tuning;
    Path *y = &path_store[1];
    Rng rng = rng_new(seed, 4);
    for (uint64_t c = 0; c < n; c++) {
        Move move = { 0 };
        if (bidir_propose(space, tuning, x, y, &rng, &move) != PROPOSED || move.s != i - 1 || move.t != i + 1 || move.k_a != 2) continue;
        if (!scene_visible(scene, &y->v[move.joined].point, &y->v[move.joined + 1].point)) continue;
        put(&seen, one_vertex_cell(space, y, i), 1);
    }
    ref_path(space, x, FAULT_NONE, &ref_store[0]);
    Real label = ref_p_d1(x->k, 2, FAULT_NONE) * ref_p_a1(x->k, 2, 2, space->max_depth, FAULT_NONE) * ref_p_d2(tuning, x, &ref_store[0], i - 1, i + 1);
    const Camera *camera = &scene->camera;
    bool from_lens = i > 1;
    const Point *from = &x->v[from_lens ? i + 1 : 0].point, *other = &x->v[from_lens ? i - 1 : 2].point;
    Point *z = &y->v[i].point;
    path_copy(y, x);
    for (uint64_t c = 0; c < n; c++) {
        Vec3 w = from_lens ? camera_direction(camera, from, rng_double(&rng) * camera->width, rng_double(&rng) * camera->height)
                           : sample_cosine(from->surface.ng, &rng);
        if (!scene_trace(scene, from, w, z) || material_is_specular(z->surface.material) || !scene_visible(scene, z, other)) continue;
        RefPath *r = &ref_store[2];
        ref_path(space, y, FAULT_NONE, r);
        if (!r->passes || r->raster_x < 0 || r->raster_x >= camera->width || r->raster_y < 0 || r->raster_y >= camera->height) continue;
        Real p_left = ref_p_lens(r, i - 1, FAULT_NONE) * r->v[i - 1].G, p_right = ref_p_light(r, i + 1, FAULT_NONE) * r->v[i].G;
        Real own = from_lens ? p_right : p_left;
        Real slip = from_lens ? p_left * r->v[i].G / r->v[i - 1].G + p_right : p_left + p_right * r->v[i - 1].G / r->v[i].G;
        int cell = one_vertex_cell(space, y, i);
        put(&told[0], cell, (double)(label * (p_left + p_right) / 2 / own));
        put(&told[1], cell, (double)(label / 2));
        put(&told[2], cell, (double)(label * slip / 2 / own));
    }
    for (int h = 0; h < TOLD; h++) out[h] = deviate(&seen, &told[h]);
}

/* An independent sampler of the other rows: steps drawn here, rays and laws of reflection from the scene's and the materials' public functions. */
static Vec3 turned(const Tuning *t, Vec3 w, Rng *rng, Fault fault)
{
    double theta = t->theta2 * exp(t->log_theta * rng_double(rng)), phi = 2 * PI * rng_double(rng);
    if (fault != FAULT_NONE) theta *= 1.5;             /* planted: cones too wide */
    Vec3 a, b;
    frame(w, &a, &b);
    return add(scale(cos(theta), w), scale(sin(theta), add(scale(cos(phi), a), scale(sin(phi), b))));
}

/* w, off the mirror image at 'old' as it is, by the rotation that takes that to the mirror image here. [Rodrigues] */
static Vec3 carried(const Surface *old, Vec3 known_old, Vec3 w, const Surface *here, Vec3 known, Fault fault)
{
    Vec3 a = sub(scale(2 * dot(known_old, old->ns), old->ns), known_old), b = sub(scale(2 * dot(known, here->ns), here->ns), known);
    double sine = length(cross(a, b)), cosine = dot(a, b);
    if (fault != FAULT_NONE) return b;                 /* planted: the mirror image itself */
    if (!(sine > 0)) return w;
    Vec3 axis = normalize(cross(a, b));
    return normalize(add(add(scale(cosine, w), scale(sine, cross(axis, w))), scale((1 - cosine) * dot(axis, w), axis)));
}

static bool same_lobes(const Path *x, const Path *y, int from)
{
    for (int i = from > 0 ? from : 1; i < x->k; i++)
        if (ref_sharp(x, i) != ref_sharp(y, i)) return false;
    return true;
}

static bool evaluates(const Space *space, Path *y)
{
    if (y->k > space->max_depth) return false;
    ref_path(space, y, FAULT_NONE, &ref_store[1]);
    const RefPath *r = &ref_store[1];
    const Camera *camera = &space->scene->camera;
    if (!r->passes || r->raster_x < 0 || r->raster_x >= camera->width || r->raster_y < 0 || r->raster_y >= camera->height) return false;
    if (space->direct == DIRECT_INCLUDED) return true;
    int i = y->k - 1;                                  /* direct: L D? S* E */
    while (i > 0 && y->v[i].mode != MODE_NONE) i--;
    return i > 1;
}

static bool walk_from_lens(const Space *space, const Tuning *tuning, const Path *x, Path *y, const char *row, Rng *rng, Fault fault)
{
    const Camera *camera = &space->scene->camera;
    bool drawn = strcmp(row, "subpath") == 0;
    int m = ref_lens_suffix(x, row), n = 0;
    double rx = rng_double(rng) * camera->width, ry = rng_double(rng) * camera->height;
    if (!drawn) {
        double u = rng_double(rng), r = tuning->r2 * exp(tuning->log_r * u), phi = 2 * PI * rng_double(rng);
        if (fault == FAULT_NO_COSINE) r = tuning->r2 * sqrt(u);      /* planted: uniform over the disc */
        rx = x->raster_x + r * cos(phi);
        ry = x->raster_y + r * sin(phi);
        if (rx < 0 || rx >= camera->width || ry < 0 || ry >= camera->height) return false;
    }
    Vertex *v = malloc(sizeof *v * (size_t)(space->max_depth + 2));
    bool ok = true;
    const Point *from = &x->v[x->k].point;
    Vec3 w = camera_direction(camera, from, rx, ry);
    for (;; n++) {
        v[n] = (Vertex){ 0 };
        ok = n <= space->max_depth && scene_trace(space->scene, from, w, &v[n].point);
        if (!ok) break;
        const Surface *surface = &v[n].point.surface;
        const Vertex *old = &x->v[x->k - 1 - n];
        bool specular = material_is_specular(surface->material), last = drawn ? !specular : x->k - 1 - n == m;
        if (last) {
            ok = m == 0 || !specular;
            break;
        }
        if (drawn) {
            bool front = dot(w, surface->ng) < 0;
            Real R = surface->material->kind == MATERIAL_MIRROR ? 1
                   : ref_fresnel(front ? 1 : surface->material->ni, front ? surface->material->ni : 1, ref_abs(ref_dot(w, surface->ns)));
            if (fault != FAULT_NONE && R < 1) R = 0.5;  /* planted */
            v[n].mode = rng_double(rng) < (double)R ? MODE_REFLECT : MODE_REFRACT;
            ok = bsdf_follow(surface, neg(w), v[n].mode, &w);
        } else if (old->mode != MODE_NONE) {
            v[n].mode = old->mode;
            ok = specular && bsdf_follow(surface, neg(w), old->mode, &w);
        } else if (ref_sharp(x, x->k - 1 - n)) {
            ok = !specular;
            w = carried(&old->point.surface, normalize(sub(old[1].point.p, old->point.p)), normalize(sub(old[-1].point.p, old->point.p)), surface, neg(w),
                        fault == FAULT_LOBE_LOST ? fault : FAULT_NONE);
        } else {
            ok = !specular;
            w = turned(tuning, neg(normalize(sub(old->point.p, old[-1].point.p))), rng, fault == FAULT_DRAWN_AS_COPIED ? fault : FAULT_NONE);
        }
        if (!ok) break;
        from = &v[n].point;
    }
    if (ok && m + n + 1 <= space->max_depth) {
        path_copy(y, x);
        y->k = m + n + 1;
        y->v[y->k] = x->v[x->k];
        for (int i = 0; i <= n; i++) y->v[y->k - 1 - i] = v[i];
    } else ok = false;
    free(v);
    return ok && (drawn || same_lobes(x, y, strcmp(row, "chain") == 0 ? m - 1 : m)) && evaluates(space, y);
}

static bool walk_from_caustic(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Fault fault)
{
    int m = ref_caustic_suffix(x);
    path_copy(y, x);
    Vec3 w = turned(tuning, normalize(sub(x->v[m + 1].point.p, x->v[m].point.p)), rng, fault == FAULT_LOBE_LOST ? FAULT_NONE : fault);
    for (int i = m + 1; i < x->k; i++) {
        Point hit;
        if (!scene_trace(space->scene, &y->v[i - 1].point, w, &hit)) return false;
        y->v[i].point = hit;
        if (material_is_specular(hit.surface.material) != (x->v[i].mode != MODE_NONE)) return false;
        if (i == x->k - 1) break;
        Vec3 p = x->v[i].point.p;
        if (x->v[i].mode == MODE_NONE)
            w = carried(&x->v[i].point.surface, normalize(sub(x->v[i - 1].point.p, p)), normalize(sub(x->v[i + 1].point.p, p)), &hit.surface, neg(w),
                        fault == FAULT_LOBE_LOST ? fault : FAULT_NONE);
        else if (!bsdf_follow(&hit.surface, neg(w), x->v[i].mode, &w)) return false;
    }
    return same_lobes(x, y, m) && evaluates(space, y);
}

/* The scale of the step (8) and its direction (8), the second scale where a direction was turned too; for the subpath mutation the number of
 * specular vertices (4) and where on the film (16) */
static int step_cell(const Space *space, const Tuning *tuning, const char *row, const Path *x, const Path *y)
{
    const Camera *camera = &space->scene->camera;
    double size, angle, rx[2], ry[2];
    for (int i = 0; i < 2; i++) {
        const Path *p = i ? y : x;
        Vec3 lens = p->v[p->k].point.p;
        ref_film(camera, lens, normalize(sub(p->v[p->k - 1].point.p, lens)), &rx[i], &ry[i]);
    }
    if (strcmp(row, "subpath") == 0) {
        int specular = 0;
        while (y->v[y->k - 1 - specular].mode != MODE_NONE) specular++;
        return (specular < 3 ? specular : 3) * 16 + (int)(4 * rx[1] / camera->width) * 4 + (int)(4 * ry[1] / camera->height);
    }
    bool caustic = strcmp(row, "caustic") == 0, chain = strcmp(row, "chain") == 0;
    size = log(hypot(rx[1] - rx[0], ry[1] - ry[0]) / tuning->r2) / tuning->log_r;
    angle = atan2(ry[1] - ry[0], rx[1] - rx[0]);
    if (caustic || chain) {
        int i = x->k - 1;              /* the turned vertex, and the next one along the turned direction */
        while (chain && i > 1 && ref_sharp(x, i)) i--;
        if (caustic) i = ref_caustic_suffix(x);
        int next = caustic ? i + 1 : i - 1;
        Vec3 p, q, old = normalize(sub(x->v[next].point.p, x->v[i].point.p)), w = normalize(sub(y->v[next].point.p, y->v[i].point.p));
        double turn = log((double)ref_angle(old, w) / tuning->theta2) / tuning->log_theta;
        frame(old, &p, &q);
        if (caustic) size = turn;
        angle = caustic ? atan2(dot(w, q), dot(w, p)) : (turn - 0.5) * 2 * PI;
    }
    return (int)fmax(0, fmin(7, size * 8)) * 8 + (int)fmax(0, fmin(7, (angle / (2 * PI) + 0.5) * 8));
}

/* Deviates from the independent sampler, and from it with a fault. */
static void steps(const Stage *stage, const Path *x, int row, uint64_t n, uint64_t seed, Fault fault, double *right, double *wrong)
{
    static Histogram seen, told[2];
    seen = told[0] = told[1] = (Histogram){ .n = (double)n };
    const Space *space = &stage->space;
    const Tuning *tuning = &stage->sampler.tuning;
    const char *name = mutation_table[row].name;
    Path *y = &path_store[1];
    Rng rng = rng_new(seed, 5);
    for (uint64_t i = 0; i < n; i++) {
        Move move = { 0 };
        if (mutation_table[row].propose(space, tuning, x, y, &rng, &move) == PROPOSED) put(&seen, step_cell(space, tuning, name, x, y), 1);
        for (int h = 0; h < (fault == FAULT_NONE ? 1 : 2); h++) {
            Fault f = h ? fault : FAULT_NONE;
            bool ok = row == 2 ? walk_from_caustic(space, tuning, x, y, &rng, f) : walk_from_lens(space, tuning, x, y, name, &rng, f);
            if (ok) put(&told[h], step_cell(space, tuning, name, x, y), 1);
        }
    }
    *right = deviate(&seen, &told[0]);
    *wrong = fault == FAULT_NONE ? NAN : deviate(&seen, &told[1]);
}

/* The u-th seed that a row applies to, with k edges or more */
static bool start_from(const Stage *stage, int row, int k, double u, Path *x)
{
    for (uint64_t i = 0; i < 2000; i++) {
        if (!bootstrap_seed(&stage->boot, &stage->space, stage->bdpt, even(u, i, 0), x) || x->k < k || x->k > 6) continue;
        if (mutation_table[row].applies(&stage->space, x)) return true;
    }
    return false;
}

static bool diffuse_path(const Path *x)
{
    for (int i = 1; i < x->k; i++)
        if (x->v[i].mode != MODE_NONE) return false;
    return true;
}

static void test_proposals(uint64_t n)
{
    Path *x = &path_store[0];
    static const char *const bidir_scene[] = { "scenes/cornell.obj", "scenes/furnace.obj" };
    for (int c = 0; c < 2; c++) {
        Stage stage;
        if (!stage_open(&stage, bidir_scene[c], DIRECT_EXCLUDED, false, 6000)) continue;
        const Tuning *tuning = &stage.sampler.tuning;
        const Camera *camera = &stage.scene.camera;
        CHECK_NEAR(PI * tuning->r2 * tuning->r2, 0.05 * camera->width * camera->height, 1e-6 * camera->width * camera->height);   /* 5 % of the film */
        CHECK_NEAR(tuning->r2 * exp(tuning->log_r), 0.1, 1e-9);                                                                    /* 0.1 pixel */
        for (int i = 0; i < 3; i++) {
            stage.sampler.tuning.p_d2_importance = i * 0.5;
            if (!CHECK(start_from(&stage, 0, 3, 0.1 + 0.3 * i, x))) continue;
            double z = labels(&stage, x, n, (uint64_t)i + 20, FAULT_NONE), fault = NAN;
            if (i > 0) fault = labels(&stage, x, n / 4, (uint64_t)i + 20, FAULT_NO_P_D2);
            printf("labels, %s, importance %.1f, k %d: deviate %.2f; planted: uniform %.1f\n", stage.name, i * 0.5, x->k, z, fault);
            CHECK(z < DEVIATE);
            if (i > 0) CHECK(fault > DEVIATE);
        }
        stage.sampler.tuning.p_d2_importance = 0.5;
        double worst_G = 0;
        for (int i = 0; i < 2; i++) {
            double u = 0.2 + 0.5 * i;
            do u += 0.013;
            while (start_from(&stage, 0, 3, u, x) && !diffuse_path(x) && u < 1);
            for (int side = 0; side < 2; side++) {
                double z[TOLD];
                one_vertex(&stage, x, side ? 1 : x->k - 1, n, 30 + (uint64_t)i, z);
                printf("one vertex at the %s, %s, k %d: deviate %.2f; planted: way %.1f, G %.1f\n",
                       side ? "light" : "lens", stage.name, x->k, z[0], z[1], z[2]);
                CHECK(z[0] < DEVIATE);
                CHECK(z[1] > DEVIATE);
                worst_G = fmax(worst_G, z[2]);
            }
        }
        CHECK(worst_G > DEVIATE);
        stage_close(&stage);
    }
    /* fault: which of the sampler's above */
    static const struct { int row; const char *scene; Fault fault; } plan[] = {
        { 1, "scenes/cornell.obj", FAULT_NO_COSINE }, { 1, "scenes/pool.obj", FAULT_NO_COSINE }, { 1, "test/scenes/water-smooth.obj", FAULT_NO_COSINE },
        { 2, "scenes/caustic.obj", FAULT_NO_COSINE }, { 2, "test/scenes/mirror-smooth.obj", FAULT_NO_COSINE },
        { 3, "scenes/pool.obj", FAULT_DRAWN_AS_COPIED }, { 3, "test/scenes/water-smooth.obj", FAULT_DRAWN_AS_COPIED },
        { 4, "scenes/pool.obj", FAULT_DRAWN_AS_COPIED }, { 4, "scenes/cornell.obj", FAULT_NONE }, { 4, "test/scenes/underwater.obj", FAULT_DRAWN_AS_COPIED },
        { 1, "test/scenes/narrow.obj", FAULT_NO_COSINE }, { 2, "test/scenes/narrow.obj", FAULT_LOBE_LOST }, { 3, "test/scenes/narrow.obj", FAULT_LOBE_LOST },
    };
    for (size_t i = 0; i < sizeof plan / sizeof plan[0]; i++) {
        Stage stage;
        if (!stage_open(&stage, plan[i].scene, DIRECT_EXCLUDED, false, 6000)) continue;
        double caught = 0;
        for (int c = 0; c < 2; c++) {
            if (!CHECK(start_from(&stage, plan[i].row, 2, 0.15 + 0.4 * c, x))) continue;
            double right, wrong;
            steps(&stage, x, plan[i].row, n / 4, 40 + (uint64_t)c, plan[i].fault, &right, &wrong);
            printf("%s, %s, k %d: deviate %.2f; planted %.1f\n", mutation_table[plan[i].row].name, stage.name, x->k, right, wrong);
            CHECK(right < DEVIATE);
            caught = fmax(caught, wrong);
        }
        if (plan[i].fault != FAULT_NONE) CHECK(caught > DEVIATE);
        stage_close(&stage);
    }
}

int main(int argc, char **argv)
{
    double factor = argc > 1 ? atof(argv[1]) : 1, start = seconds();
    test_tables();
    test_ways();
    test_examples();
    test_faults();
    test_proposals(400000);
    test_scenes((uint64_t)(100000 * factor));
    printf("%.1f s\n", seconds() - start);
    return check_report();
}
