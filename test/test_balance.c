/* Each row of the mutation table alone, and every pair of rows, in detailed balance: from exact starts, a few steps leave the image and the
 * flows between classes of paths unchanged (balance.h). Planted faults must be caught by the same test. Then the bootstrap: b^ times what a
 * chain records is exact for tiny bootstraps and few steps.
 *
 *     test_balance [FACTOR [SEED]]      FACTOR times the samples, for a long run; another seed
 */
#include "balance.h"
#include "check.h"
#include "folder.h"
#include "test_faults.h"

/* A false alarm of the whole program once in a million: |z| beyond 6.6 in any of some ten thousand comparisons. */
enum { COMPARISONS = 25000 };
static const double FALSE_ALARM = 1e-6;
static double z_limit;
static int comparisons;

static double factor = 1;
static uint64_t seed = 1;

/* ---- scenes ---- */

/* A box with a sheet of water half way up, half as wide as the box, so that light goes past it as well as through it; its corner normals lean
 * outwards by 21 degrees. The eye is below, a large lamp under the ceiling. Reflected and refracted paths end at the same points, and
 * every factor of S shows: no shipped scene has all of that within reach of short paths. */
static const char tank_obj[] =
    "mtllib tank.mtl\n"
    "v -1 -1 -1\nv 1 -1 -1\nv 1 -1 1\nv -1 -1 1\nv -1 1 -1\nv 1 1 -1\nv 1 1 1\nv -1 1 1\n"
    "v -1 0 -1\nv 0.2 0 -1\nv 0.2 0 1\nv -1 0 1\n"
    "v -0.6 0.95 -0.6\nv 0.6 0.95 -0.6\nv 0.6 0.95 0.6\nv -0.6 0.95 0.6\n"
    "vn -0.8 1 -0.8\nvn 0.8 1 -0.8\nvn 0.8 1 0.8\nvn -0.8 1 0.8\n"
    "usemtl wall\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    "usemtl water\nf 12//4 11//3 10//2 9//1\n"
    "usemtl light\nf 13 14 15 16\n";
static const char tank_mtl[] = "newmtl wall\nKd 0.6 0.6 0.6\nnewmtl water\nillum 4\nNi 1.5\nnewmtl light\nKd 0 0 0\nKe 5 5 5\n";
static const char glowing_mtl[] = "newmtl wall\nKd 0.6 0.6 0.6\nKe 1 1 1\nnewmtl water\nillum 4\nNi 1.5\nnewmtl light\nKd 0 0 0\nKe 5 5 5\n";
static const char tank_cam[] = "eye 0.3 -0.6 0.8\nlook -0.2 -0.1 -0.8\nfov 90\nsize 32 32\n";

/* Its walls may glow, and be seen in the water and through it at all angles. */
static bool load_tank(Scene *scene, bool glowing, const CameraSettings *camera, Report *report)
{
    folder_write_text("tank.obj", tank_obj);
    folder_write_text("tank.mtl", glowing ? glowing_mtl : tank_mtl);
    folder_write_text("tank.cam", tank_cam);
    return scene_load(scene, folder_path("tank.obj"), camera, BVH_FAST, report);
}

/* film: pixels each way, 0 for the scene's own; only the scan order minds */
static bool load(Scene *scene, const char *file, uint32_t film)
{
    Report report = { .warnings = NULL };
    CameraSettings camera = { .has_size = film > 0, .width = film, .height = film };
    bool glowing = strcmp(file, "tank, glowing") == 0;
    if (glowing) {
        camera.has_eye = camera.has_look = true;
        camera.eye = vec3(-0.9, 0.12, 0);
        camera.look = vec3(0.2, -0.1, 0);
    }
    bool ok = strncmp(file, "tank", 4) == 0 ? load_tank(scene, glowing, &camera, &report) : scene_load(scene, file, &camera, BVH_FAST, &report);
    if (!CHECK(ok)) printf("%s: %s\n", file, report.error);
    return ok;
}

/* ---- subjects ---- */

enum { MAX_SUBJECTS = MUTATIONS * (MUTATIONS + 1) / 2 };
static Subject subject[MAX_SUBJECTS];
static char names[MAX_SUBJECTS][64];
static int subjects;

static void add_subject(const char *first, const char *second, Sampler sampler)
{
    if (!CHECK(subjects < MAX_SUBJECTS)) return;
    snprintf(names[subjects], sizeof names[0], "%s%s%s", first, *second ? "+" : "", second);
    memset(&subject[subjects], 0, sizeof subject[0]);
    subject[subjects].name = names[subjects];
    subject[subjects].sampler = sampler;
    subjects++;
}

/* Steps that carry a path from class to class, unlike the smallest ones of a render. Right is right with any constants. */
static Sampler large_steps(Sampler sampler, double smallest_over_largest)
{
    sampler.tuning.log_r = sampler.tuning.log_theta = log(smallest_over_largest);
    sampler.tuning.theta2 = 0.5;
    return sampler;
}

/* ---- the rows ---- */

static void test_rows(void)
{
    static const struct { const char *file; int depth; Starts starts; double samples; uint64_t steps; } list[] = {
        { "scenes/cornell.obj", 8, { .unit = 0.1, .cap = 1 }, 1.5e5, 3 },
        { "scenes/caustic.obj", 8, { .unit = 0.7, .cap = 2 }, 7e5, 4 },
        { "scenes/pool.obj", 8, { .unit = 0.3, .cap = 0.5 }, 4e5, 3 },
        { "scenes/pool.obj", 8, { START_AIMED, 4, 10, 0.08, { 0, 0, 0 } }, 7e5, 4 },
        { "scenes/glossy.obj", 8, { .unit = 0.03, .cap = 0.1 }, 4e5, 3 },
        { "scenes/door.obj", 8, { .unit = 1, .cap = 1.5 }, 2e5, 3 },
        { "test/scenes/mirror-smooth.obj", 8, { .unit = 0.5, .cap = 2 }, 2e6, 4 },
        { "test/scenes/water-smooth.obj", 8, { .unit = 10, .cap = 30 }, 1.5e6, 4 },
        { "test/scenes/underwater.obj", 8, { .unit = 4, .cap = 17 }, 1e6, 3 },
        { "test/scenes/lens-dof.obj", 8, { .unit = 0.3, .cap = 0.6 }, 1.5e6, 3 },
        { "test/scenes/narrow.obj", 7, { .unit = 0.5, .cap = 3 }, 4e5, 4 },
        { "tank", 6, { .unit = 0.5, .cap = 3 }, 1e5, 3 },
    };
    printf("each row alone and every pair, largest |z| over classes (false alarm beyond %.2f)\n", z_limit);
    for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
        Scene scene;
        if (!load(&scene, list[i].file, 0)) continue;
        Space space = { .scene = &scene, .max_depth = list[i].depth, .direct = DIRECT_EXCLUDED };
        subjects = 0;
        for (int a = 0; a < MUTATIONS; a++)
            for (int b = a; b < MUTATIONS; b++) {
                Sampler s = sampler_for(&scene, 1u << a | 1u << b);
                if (s.share[a] > 0 && s.share[b] > 0) add_subject(mutation_table[a].name, a == b ? "" : mutation_table[b].name, large_steps(s, 0.05));
            }
        Balance run = balance_run(&space, list[i].starts, subject, subjects, (uint64_t)(list[i].samples * factor), list[i].steps, seed);
        printf("  %s%s: %.2g starts\n   ", list[i].file, list[i].starts.kind == START_AIMED ? ", L S+ D S* E" : "", (double)run.starts);
        int tested = 0;
        for (int s = 0; s < subjects; s++) {
            Subject *me = &subject[s];
            if (me->classes > 0) printf(" %s %.1f (%d)", me->name, me->z, me->classes);
            comparisons += me->classes;
            tested += me->classes > 0;
            if (!CHECK(me->z < z_limit)) printf("    %s, %s: class %u off by %.2g of b, z %.2f\n", list[i].file, me->name, me->worst_class, me->difference, me->z);
        }
        printf("\n");
        CHECK(run.bad == 0);
        CHECK(run.weight_error < 1e-9);
        CHECK((double)run.starts > 5000 * factor);
        CHECK(tested >= (list[i].starts.kind == START_AIMED ? 3 : subjects * 3 / 4));
        scene_free(&scene);
    }
}

/* ---- planted faults ---- */

typedef struct {
    const char *name;
    int row;                                       /* of mutation_table, replaced */
    enum { ALONE, AMONG_ALL, BESIDE_LEFT, SEEN } company;   /* left: see left_applies; seen: seen_mutation in place of the row */
    bool (*applies)(const Space *, const Path *);  /* NULL: as it is */
    Outcome (*propose)(const Space *, const Tuning *, const Path *, Path *, Rng *, Move *);
} Fault;                                           /* both NULL: no fault, and must pass */

enum { GROUP = 10 };
/* Faults that are caught from the same starts. */
static const struct {
    const char *file;
    DirectClass direct;
    int depth;
    uint32_t film;
    Starts starts;
    double samples;
    uint64_t steps;
    double smallest;                               /* over largest step */
    Fault fault[GROUP];
} fault_group[] = {
    { "tank", DIRECT_EXCLUDED, 6, 0, { .unit = 0.5, .cap = 3 }, 3e5, 6, 0.05, {
        { "caustic: drawn S for a copied mode", CAUSTIC, ALONE, NULL, caustic_drawn },
        { "chain: drawn S for a copied mode", CHAIN, ALONE, NULL, chain_drawn },
        { "caustic: |cos| left out", CAUSTIC, ALONE, NULL, caustic_no_cosine },
        { "chain: |cos| left out", CHAIN, ALONE, NULL, chain_no_cosine },
        { "caustic: normal factor left out of S>", CAUSTIC, ALONE, NULL, caustic_no_normals },
        { "subpath: wrong suffix accepted", SUBPATH, ALONE, subpath_wrong_applies, subpath_wrong },
        { "caustic: suffix one vertex too far", CAUSTIC, ALONE, caustic_far_applies, caustic_far },
        { "bidir: T of the way taken alone", BIDIR, ALONE, NULL, bidir_one_way },
        { "caustic: T left out", CAUSTIC, ALONE, NULL, f_alone_caustic },
        { "chain: T left out", CHAIN, ALONE, NULL, f_alone_chain },
    } },
    { "tank, glowing", DIRECT_ONLY, 6, 0, { .unit = 0.5, .cap = 5 }, 1e5, 6, 0.05, {
        { "seen: right", LENS, SEEN, NULL, NULL },
        { "seen: drawn S for a copied mode", LENS, SEEN, NULL, seen_drawn },
    } },
    { "tank", DIRECT_EXCLUDED, 6, 0, { .unit = 0.5, .cap = 3 }, 1e5, 16, 0.5, {
        { "caustic, q_i changes: right", CAUSTIC, BESIDE_LEFT, NULL, NULL },
        { "caustic: q_i left out", CAUSTIC, BESIDE_LEFT, NULL, caustic_no_choice },
        { "chain, q_i changes: right", CHAIN, BESIDE_LEFT, NULL, NULL },
        { "chain: q_i left out", CHAIN, BESIDE_LEFT, NULL, chain_no_choice },
    } },
    { "scenes/cornell.obj", DIRECT_INCLUDED, 8, 0, { .unit = 1, .cap = 10 }, 1.5e5, 16, 0.5, {
        { "lens, q_i changes: right", LENS, BESIDE_LEFT, NULL, NULL },
        { "lens: q_i left out", LENS, BESIDE_LEFT, NULL, lens_no_choice },
        { "subpath, q_i changes: right", SUBPATH, BESIDE_LEFT, NULL, NULL },
        { "subpath: q_i left out", SUBPATH, BESIDE_LEFT, NULL, subpath_no_choice },
    } },
    { "scenes/cornell.obj", DIRECT_INCLUDED, 8, 0, { .unit = 1, .cap = 10 }, 1e5, 24, 0.05, {
        { "bidir: T left out", BIDIR, ALONE, NULL, f_alone_bidir },
        { "lens: T left out", LENS, ALONE, NULL, f_alone_lens },
        { "subpath: T left out", SUBPATH, ALONE, NULL, f_alone_subpath },
        { "bidir: forced acceptance", BIDIR, ALONE, NULL, forced_bidir },
        { "subpath: forced acceptance", SUBPATH, ALONE, NULL, forced_subpath },
    } },
    { "tank", DIRECT_EXCLUDED, 5, 0, { .unit = 0.5, .cap = 3 }, 5e5, 16, 0.05, {
        { "bidir: eta^2 left out of S<", BIDIR, ALONE, NULL, bidir_no_eta },
    } },
    { "tank", DIRECT_EXCLUDED, 4, 0, { .unit = 0.3, .cap = 3 }, 5e5, 16, 0.05, {
        { "bidir: normal factor left out of S>", BIDIR, ALONE, NULL, bidir_no_normals },
    } },
    { "tank", DIRECT_EXCLUDED, 5, 0, { .unit = 0.5, .cap = 3 }, 4e5, 16, 0.9, {
        { "lens: steps that scale with the path", LENS, ALONE, NULL, lens_scaled },
        { "caustic: steps that scale with the path", CAUSTIC, ALONE, NULL, caustic_scaled },
    } },
    { "tank", DIRECT_EXCLUDED, 5, 6, { .unit = 0.5, .cap = 3 }, 2e5, 8, 0.05, {
        { "subpath: pixels in scan order", SUBPATH, ALONE, NULL, subpath_scan },
    } },
    { "tank", DIRECT_EXCLUDED, 8, 0, { .unit = 0.5, .cap = 3 }, 3e5, 12, 0.05, {
        { "manifold: right", MANIFOLD, ALONE, NULL, NULL },
        { "manifold: |dw/dx_0| left out", MANIFOLD, ALONE, NULL, manifold_no_spread },
    } },
    { "test/scenes/narrow.obj", DIRECT_EXCLUDED, 7, 0, { .unit = 0.5, .cap = 6 }, 1e6, 30, 0.1, {
        { "narrow lobes, lens: |cos| left out", LENS, ALONE, NULL, lens_no_cosine },
        { "narrow lobes, caustic: |cos| left out", CAUSTIC, ALONE, NULL, caustic_no_cosine },
        { "narrow lobes, chain: |cos| left out", CHAIN, ALONE, NULL, chain_no_cosine },
        { "narrow lobes, manifold: |dw/dx_0| left out", MANIFOLD, ALONE, NULL, manifold_no_spread },
    } },
    { "test/scenes/underwater.obj", DIRECT_EXCLUDED, 8, 0, { .unit = 4, .cap = 17 }, 1e6, 12, 0.05, {
        { "lens: drawn S for a copied mode", LENS, ALONE, NULL, lens_drawn },
    } },
    { "scenes/furnace.obj", DIRECT_INCLUDED, 3, 4, { .unit = 1, .cap = 10 }, 1.5e5, 12, 0.05, {
        { "bidir: p_d1 not normalised again", BIDIR, ALONE, NULL, bidir_raw_p_d1 },
    } },
    { "scenes/furnace.obj", DIRECT_INCLUDED, 3, 4, { .unit = 1, .cap = 10 }, 6e4, 12, 0.05, {
        { "bidir: p_a1 not normalised again", BIDIR, ALONE, NULL, bidir_raw_p_a1 },
        { "bidir: p_d2 left out", BIDIR, ALONE, NULL, bidir_no_p_d2 },
        { "bidir: q_i left out", BIDIR, AMONG_ALL, NULL, bidir_no_choice },
    } },
};

static void test_faults(void)
{
    static Mutation table[GROUP][MUTATIONS];
    printf("planted faults, largest |z| over classes\n");
    for (size_t g = 0; g < sizeof fault_group / sizeof fault_group[0]; g++) {
        Scene scene;
        if (!load(&scene, fault_group[g].file, fault_group[g].film)) continue;
        Space space = { .scene = &scene, .max_depth = fault_group[g].depth, .direct = fault_group[g].direct };
        subjects = 0;
        for (int f = 0; f < GROUP && fault_group[g].fault[f].name; f++) {
            const Fault *fault = &fault_group[g].fault[f];
            memcpy(table[f], mutation_table, sizeof table[f]);
            Mutation *row = &table[f][fault->row];
            if (fault->company == SEEN) *row = seen_mutation;
            if (fault->applies) row->applies = fault->applies;
            if (fault->propose) row->propose = fault->propose;
            Sampler s = sampler_for(&scene, ~0u);
            s.table = table[f];
            for (int r = 0; r < MUTATIONS; r++) s.share[r] = fault->company == AMONG_ALL ? mutation_table[r].share : r == fault->row;
            if (fault->company == BESIDE_LEFT) {
                int left = fault->row == LENS ? CAUSTIC : LENS;
                table[f][left] = table[f][BIDIR];
                table[f][left].applies = left_applies;
                s.share[left] = left_share;
                s.share[BIDIR] = beside_share;
            }
            add_subject(fault->name, "", large_steps(s, fault_group[g].smallest));
            subject[f].faulty = fault->applies || fault->propose;
        }
        balance_run(&space, fault_group[g].starts, subject, subjects, (uint64_t)(fault_group[g].samples * factor), fault_group[g].steps, seed);
        for (int s = 0; s < subjects; s++) {
            printf("    %-42s %6.1f   (%s)\n", subject[s].name, subject[s].z, fault_group[g].file);
            if (subject[s].faulty) CHECK(subject[s].z > z_limit);
            else CHECK(subject[s].classes > 0 && subject[s].z < z_limit);
            if (!subject[s].faulty) comparisons += subject[s].classes;
        }
        scene_free(&scene);
    }
}

/* ---- the bootstrap ---- */

/* What 'n' bootstrap samples and a chain or two of a few steps say of the image's quarters: b^ * recorded. */
typedef enum { AS_IT_IS, OTHER_B, UNIFORM_SEEDS } BootstrapFault;
enum { QUARTERS = 8 };                             /* quarter x whether a vertex is specular */

typedef struct { const Space *space; double value[QUARTERS]; } Quarters;

static int quarter_of(const Space *space, double x, double y, bool specular)
{
    const Camera *camera = &space->scene->camera;
    return (x * 2 > camera->width) + 2 * (y * 2 > camera->height) + 4 * specular;
}
static void record_quarter(void *context, const Path *x, double weight)
{
    Quarters *q = context;
    bool specular = false;
    for (int i = 1; i < x->k; i++) specular |= x->v[i].mode != MODE_NONE;
    q->value[quarter_of(q->space, x->raster_x, x->raster_y, specular)] += weight;
}

/* The same from independent samples: the candidates' paths, weighed. */
static void sampled_quarters(const Space *space, uint64_t n, double mean[QUARTERS], double variance[QUARTERS])
{
    static BalanceCandidates found;
    Bdpt *bdpt = bdpt_new();
    Path *x = calloc(1, sizeof *x);
    double sum[QUARTERS] = { 0 }, square[QUARTERS] = { 0 };
    for (uint64_t i = 0; i < n; i++) {
        Rng rng = rng_new(seed, 70000000 + i);
        double u = rng_double(&rng), v = rng_double(&rng);
        found.n = 0;
        found.cap = INFINITY;
        bdpt_sample(bdpt, space, u * space->scene->camera.width, v * space->scene->camera.height, ONE_WAY, NULL, &rng, balance_collect, &found);
        Quarters q = { space, { 0 } };
        for (int c = 0; c < found.n; c++)
            if (bdpt_path(bdpt, space, found.all[c].n_light, found.all[c].n_lens, x)) record_quarter(&q, x, found.all[c].weight);
        for (int k = 0; k < QUARTERS; k++) { sum[k] += q.value[k]; square[k] += q.value[k] * q.value[k]; }
    }
    for (int k = 0; k < QUARTERS; k++) {
        mean[k] = sum[k] / (double)n;
        variance[k] = (square[k] / (double)n - mean[k] * mean[k]) / (double)n;
    }
    bdpt_free(bdpt);
    free(x);
}

static double bootstrap_z(const Space *space, uint64_t repetitions, uint64_t n, BootstrapFault fault, const double mean[QUARTERS], const double variance[QUARTERS])
{
    enum { CHAINS = 2, STEPS = 3 };
    Bdpt *bdpt = bdpt_new();
    Path *x = calloc(1, sizeof *x), *y = calloc(1, sizeof *y);
    Sampler sampler = large_steps(sampler_for(space->scene, ~0u), 0.05);
    double sum[QUARTERS] = { 0 }, square[QUARTERS] = { 0 }, worst = 0, other_b = mean[0];
    for (int k = 1; k < QUARTERS; k++) other_b += mean[k];                     /* as good as exact, and independent */
    ChainCount count = { 0 };
    for (uint64_t i = 0; i < repetitions; i++) {
        Rng rng = rng_new(seed, 90000000 + i);
        Bootstrap boot;
        if (!bootstrap_run(&boot, space, bdpt, n, seed, (i + 1) << 24)) { CHECK(false); break; }
        Quarters q = { space, { 0 } };
        double offset = rng_double(&rng);
        for (uint64_t c = 0; c < CHAINS && boot.b > 0; c++) {
            double u = even(offset, c, 0), low, high;
            if (fault == UNIFORM_SEEDS) {          /* any sample that found light, whatever its weight */
                uint64_t sample;
                do {
                    sample = rng_index(&rng, (uint32_t)n);
                    low = sample > 0 ? boot.sum[sample - 1] : 0;
                    high = boot.sum[sample];
                } while (!(high > low));
                u = (low + rng_double(&rng) * (high - low)) / boot.sum[n - 1];
            }
            if (bootstrap_seed(&boot, space, bdpt, u, x)) chain_run(space, &sampler, x, y, STEPS, &rng, record_quarter, &q, &count);
        }
        for (int k = 0; k < QUARTERS; k++) {
            double value = (fault == OTHER_B ? other_b : boot.b) * q.value[k] / (CHAINS * STEPS);
            sum[k] += value;
            square[k] += value * value;
        }
        bootstrap_free(&boot);
    }
    for (int k = 0; k < QUARTERS; k++) {
        double m = sum[k] / (double)repetitions, v = (square[k] / (double)repetitions - m * m) / (double)repetitions;
        if (mean[k] > 0) check_worse(&worst, fabs(m - mean[k]) / sqrt(v + variance[k]));
    }
    CHECK(count.bad == 0);
    bdpt_free(bdpt);
    free(x);
    free(y);
    return worst;
}

static void test_bootstrap(void)
{
    Scene scene;
    if (!load(&scene, "tank", 0)) return;
    Space space = { .scene = &scene, .max_depth = 4, .direct = DIRECT_EXCLUDED };
    double mean[QUARTERS], variance[QUARTERS];
    sampled_quarters(&space, (uint64_t)(1e6 * factor), mean, variance);
    uint64_t repetitions = (uint64_t)(14000 * factor);
    printf("b^ * recorded against independent samples, largest |z| over image quarters\n");
    double z20 = bootstrap_z(&space, repetitions, 20, AS_IT_IS, mean, variance), z50 = bootstrap_z(&space, repetitions, 50, AS_IT_IS, mean, variance);
    double other = bootstrap_z(&space, repetitions, 20, OTHER_B, mean, variance), uniform = bootstrap_z(&space, repetitions, 20, UNIFORM_SEEDS, mean, variance);
    printf("    n = 20: %.1f, n = 50: %.1f; planted: b of other samples %.1f, seeds chosen uniformly %.1f\n", z20, z50, other, uniform);
    CHECK(z20 < z_limit);
    CHECK(z50 < z_limit);
    CHECK(other > z_limit);
    CHECK(uniform > z_limit);
    scene_free(&scene);
}

int main(int argc, char **argv)
{
    if (argc > 1) factor = atof(argv[1]);
    if (argc > 2) seed = (uint64_t)atoi(argv[2]);
    z_limit = chance_limit(COMPARISONS, FALSE_ALARM);
    test_rows();
    test_faults();
    test_bootstrap();
    CHECK(comparisons < COMPARISONS);
    return check_report();
}
