/* What wrong looks like: small pictures by the right sampler, and by samplers with one deliberate fault each, explained in doc/wrong.md.
 *
 *     wrong FOLDER          writes FOLDER/wrong-NAME.png; run from the project's root; half a minute
 *
 * All light goes through the chains, no rounds, no path tracer beside them: a fault shows unmixed. For each picture it prints the mean and
 * the relMSE (image.h) against the right sampler with more chains, and by how much the mean of a tile is off at worst: there noise has been averaged
 * away, and a fault has not. Then the same samplers in the balance test. Fixed seeds. */
#include "balance.h"
#include "test_faults.h"

enum { WIDTH = 160, HEIGHT = 120, PIXELS = WIDTH * HEIGHT, BOOTSTRAP = 20000, TILE = 20 };

typedef Outcome (*Propose)(const Space *, const Tuning *, const Path *, Path *, Rng *, Move *);

/* ---- pictures ---- */

typedef struct {
    const char *name;
    Propose propose[MUTATIONS];    /* in place of the rows' own; NULL: as it is */
    unsigned rows;                 /* that are used, bit i = row i; 0: all */
    uint64_t chains, steps;        /* steps of each chain */
    bool uniform;                  /* chains start from any sample that found light, whatever its weight */
    bool no_b;                     /* 1 in its place */
} Picture;

static const struct { const char *file; Picture picture[8]; } scenes[] = {
    { "scenes/cornell.obj", {
        { "cornell-right", { NULL }, 0, 8000, 250, false, false },
        { "cornell-no-t", { f_alone_bidir, f_alone_lens, f_alone_caustic, f_alone_chain, f_alone_subpath }, 0, 8000, 250, false, false },
        { "cornell-one-way", { bidir_one_way }, 1u << BIDIR, 8000, 250, false, false },
        { "cornell-forced", { forced_bidir, forced_lens, forced_caustic, forced_chain, forced_subpath }, 0, 8000, 250, false, false },
        { "cornell-small-steps", { NULL }, 1u << LENS | 1u << CAUSTIC | 1u << CHAIN, 25, 80000, false, false },
        { "cornell-no-b", { NULL }, 0, 8000, 250, false, true },
    } },
    { "scenes/caustic.obj", {
        { "caustic-right", { NULL }, 0, 8000, 250, false, false },
        { "caustic-uniform", { NULL }, 0, 400000, 5, true, false },
        { "caustic-drawn", { NULL, lens_drawn, caustic_drawn, chain_drawn }, 0, 8000, 250, false, false },
    } },
};

typedef struct { double film[PIXELS][3]; } Film;

static void splat(void *context, const Path *x, double weight)
{
    Film *film = context;
    double *pixel = film->film[x->pixel], scale = weight / x->chi;
    pixel[0] += scale * x->colour.x;
    pixel[1] += scale * x->colour.y;
    pixel[2] += scale * x->colour.z;
}

/* A number that makes bootstrap_seed pick each sample that found light with the same chance. */
static double uniform_seed(const Bootstrap *boot, Rng *rng)
{
    double low, high;
    do {
        uint32_t i = rng_index(rng, (uint32_t)boot->n);
        low = i > 0 ? boot->sum[i - 1] : 0;
        high = boot->sum[i];
    } while (!(high > low));
    return (low + rng_double(rng) * (high - low)) / boot->sum[boot->n - 1];
}

static Sampler sampler_of(const Space *space, const Picture *picture, Mutation table[MUTATIONS])
{
    memcpy(table, mutation_table, MUTATIONS * sizeof *table);
    for (int i = 0; i < MUTATIONS; i++)
        if (picture->propose[i]) table[i].propose = picture->propose[i];
    Sampler sampler = sampler_for(space->scene, picture->rows ? picture->rows : ~0u);
    sampler.table = table;
    return sampler;
}

/* How a program renders that has chain and bootstrap but no rounds. False if memory runs out. */
static bool draw(Image *image, const Space *space, const Picture *picture, uint64_t seed)
{
    Mutation table[MUTATIONS];
    Sampler sampler = sampler_of(space, picture, table);
    Bdpt *bdpt = bdpt_new();
    Path *x = calloc(1, sizeof *x), *y = calloc(1, sizeof *y);
    Film *film = calloc(1, sizeof *film);
    Bootstrap boot = { .sum = NULL };
    bool ok = bdpt && x && y && film && bootstrap_run(&boot, space, bdpt, BOOTSTRAP, seed, 0);
    ChainCount count = { 0 };
    Rng rng = rng_new(seed, (uint64_t)1 << 40);
    double offset = rng_double(&rng);
    for (uint64_t c = 0; ok && c < picture->chains; c++) {
        double u = picture->uniform ? uniform_seed(&boot, &rng) : even(offset, c, 0);
        if (bootstrap_seed(&boot, space, bdpt, u, x)) chain_run(space, &sampler, x, y, picture->steps, &rng, splat, film, &count);
    }
    double scale = (picture->no_b ? 1 : boot.b) * PIXELS / (double)(picture->chains * picture->steps);
    for (int i = 0; ok && i < PIXELS; i++)
        for (int k = 0; k < 3; k++) image->rgb[3 * i + k] = (float)(scale * film->film[i][k]);
    bootstrap_free(&boot);
    bdpt_free(bdpt);
    free(x);
    free(y);
    free(film);
    return ok;
}

/* Luminance of a tile of TILE x TILE pixels. */
static double tile(const Image *image, int column, int row)
{
    double sum = 0;
    for (int y = row * TILE; y < (row + 1) * TILE; y++)
        for (int x = column * TILE; x < (column + 1) * TILE; x++) {
            const float *rgb = image->rgb + 3 * (y * WIDTH + x);
            sum += luminance((Rgb){ (double)rgb[0], (double)rgb[1], (double)rgb[2] });
        }
    return sum / (TILE * TILE);
}

/* The largest relative difference of a tile, signed; dark tiles are left out, being mostly noise. */
static double worst_tile(const Image *image, const Image *reference)
{
    double worst = 0, mean = 0;
    for (int row = 0; row < HEIGHT / TILE; row++)
        for (int column = 0; column < WIDTH / TILE; column++) mean += tile(reference, column, row) * TILE * TILE / PIXELS;
    for (int row = 0; row < HEIGHT / TILE; row++)
        for (int column = 0; column < WIDTH / TILE; column++) {
            double a = tile(image, column, row), b = tile(reference, column, row);
            if (b > 0.3 * mean && fabs(a / b - 1) > fabs(worst)) worst = a / b - 1;
        }
    return worst;
}

/* The largest |z| that balance.h finds; the tests draw the line at 6.6. It has starts of its own, so faults of the bootstrap do not show. */
static void print_balance(const Space *space, const Picture *picture)
{
    enum { MOST = 8 };
    static Subject subject[MOST];
    static Mutation table[MOST][MUTATIONS];
    int n = 0;
    for (int i = 0; i < MOST && picture[i].name; i++)
        if (!picture[i].no_b && !picture[i].uniform) {
            memset(&subject[n], 0, sizeof subject[n]);
            subject[n].name = picture[i].name;
            subject[n].sampler = sampler_of(space, &picture[i], table[n]);
            n++;
        }
    balance_run(space, (Starts){ .unit = 1, .cap = 10 }, subject, n, 150000, 24, 1);
    for (int i = 0; i < n; i++) printf("%-20s balance |z| %.1f\n", subject[i].name, subject[i].z);
}

int main(int argc, char **argv)
{
    if (argc != 2) { fputs("usage: wrong FOLDER\n", stderr); return 2; }
    Report report = { .warnings = stderr };
    CameraSettings camera = { .has_size = true, .width = WIDTH, .height = HEIGHT };
    Image *image = image_new(WIDTH, HEIGHT), *reference = image_new(WIDTH, HEIGHT);
    bool ok = image && reference;
    for (size_t s = 0; ok && s < sizeof scenes / sizeof scenes[0]; s++) {
        Scene scene;
        ok = scene_load(&scene, scenes[s].file, &camera, BVH_FAST, &report);
        if (!ok) break;
        Space space = { .scene = &scene, .max_depth = 8, .direct = DIRECT_INCLUDED };
        Picture more = scenes[s].picture[0];
        more.chains *= 4;
        ok = draw(reference, &space, &more, 2);
        for (const Picture *p = scenes[s].picture; ok && p->name; p++) {
            char path[1024];
            snprintf(path, sizeof path, "%s/wrong-%s.png", argv[1], p->name);
            ok = draw(image, &space, p, 1);
            if (!ok) break;
            ImageError e = image_compare(image, reference);
            printf("%-20s mean %5.2f of the right one, relMSE %5.2f, worst tile %+4.0f%%\n", p->name, e.ratio_of_means, e.relmse, 100 * worst_tile(image, reference));
            fflush(stdout);
            ok = image_write(image, path, 0, &report);
        }
        if (ok && s == 0) print_balance(&space, scenes[s].picture);
        scene_free(&scene);
    }
    if (!ok) fprintf(stderr, "wrong: %s\n", *report.error ? report.error : "out of memory");
    image_free(image);
    image_free(reference);
    return !ok;
}
