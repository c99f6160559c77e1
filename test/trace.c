/* Where a chain goes, and what it has accepted: two figures of doc/measurements.md.
 *
 *     trace FOLDER          run from the project's root; a few seconds
 *
 * FOLDER/trace.svg          one chain of MOVES mutations on the film of each scene, from the same start (a ring) with the bidirectional mutation alone
 *                           and with all strategies; a line for each accepted mutation, coloured by the strategy that made it
 * FOLDER/acceptance-SCENE.svg   accepted over proposed, for each strategy, against the length of the path that it started from
 *
 * Both without direct light, as the program leaves that to the path tracer, and without the cut of path space. The acceptances are also printed,
 * as CSV. Fixed seeds: the same machine draws the same figures. */
#include "mlt.h"
#include "svgplot.h"
#include <stdlib.h>
#include <string.h>

enum { FILM_WIDTH = 160, FILM_HEIGHT = 120, MOVES = 3000, PANEL = 2, GAP = 12, HEAD = 22, FOOT = 30, TILE = 4, COLUMNS = FILM_WIDTH / TILE, LINES = FILM_HEIGHT / TILE,
       GREYS = 16, SAMPLES = 100000, STARTS = 20000, CHAINS = 100, STEPS = 10000, LENGTHS = 30, ENOUGH = 2000 };

static const char *const scene_name[] = { "door", "caustic", "pool" };
enum { SCENES = sizeof scene_name / sizeof *scene_name };
static const char *const colour[MUTATIONS] = { "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9" };

typedef struct { Scene scene; Space space; Bdpt *bdpt; Bootstrap boot; Path *x, *y; } Lab;

static void drop(void *context, const Path *path, double weight) { (void)context; (void)path; (void)weight; }

/* One mutation; returns the row that proposed it. */
static int step(Lab *lab, const Sampler *sampler, Rng *rng, bool *accepted)
{
    ChainCount count = { 0 };
    chain_run(&lab->space, sampler, lab->x, lab->y, 1, rng, drop, NULL, &count);
    for (int i = 0; i < MUTATIONS; i++)
        if (count.row[i].proposed) {
            *accepted = count.row[i].accepted > 0;
            return i;
        }
    *accepted = false;
    return 0;
}

static void add_light(void *context, const Candidate *c)
{
    double *tile = context;
    uint32_t x = c->pixel % FILM_WIDTH, y = c->pixel / FILM_WIDTH;
    tile[y / TILE * COLUMNS + x / TILE] += luminance(c->rgb);
}

/* What is seen there, in pale grey tiles. */
static void draw_film(FILE *out, Lab *lab)
{
    double tile[COLUMNS * LINES] = { 0 }, mean = 0;
    Space all = { .scene = &lab->scene, .max_depth = lab->space.max_depth, .direct = DIRECT_INCLUDED };
    Rng rng = rng_new(3, 0);
    for (int i = 0; i < SAMPLES; i++) {
        double x = even(0, (uint64_t)i, 0) * FILM_WIDTH, y = even(0, (uint64_t)i, 1) * FILM_HEIGHT;
        bdpt_sample(lab->bdpt, &all, x, y, BOTH_WAYS, NULL, &rng, add_light, tile);
    }
    for (int i = 0; i < COLUMNS * LINES; i++) mean += tile[i] / (COLUMNS * LINES);
    for (int grey = 0; grey < GREYS; grey++) {
        unsigned level = (unsigned)(135 + 120 * grey / (GREYS - 1));
        int side = TILE * PANEL;
        fprintf(out, "<path fill='#%02x%02x%02x' d='", level, level, level);
        for (int i = 0; i < COLUMNS * LINES; i++)
            if ((int)((GREYS - 1) * smaller(1, sqrt(tile[i] / (3 * mean)))) == grey) fprintf(out, "M%d %dh%dv%dh-%dz", i % COLUMNS * side, i / COLUMNS * side, side, side, side);
        fputs("'/>\n", out);
    }
}

static bool draw_trace(FILE *out, Lab *lab, const char *scene, const char *name, unsigned allowed)
{
    static double from[MOVES][2], to[MOVES][2];
    static int row[MOVES];
    static bool seen[FILM_WIDTH * FILM_HEIGHT];
    memset(seen, 0, sizeof seen);
    Sampler sampler = sampler_for(&lab->scene, allowed);
    int n = 0, accepted = 0, pixels = 0;
    if (!bootstrap_seed(&lab->boot, &lab->space, lab->bdpt, 0.5, lab->x)) return false;
    Rng rng = rng_new(2, 0);
    double start_x = lab->x->raster_x, start_y = lab->x->raster_y;
    for (int i = 0; i < MOVES; i++) {
        bool moved;
        from[n][0] = lab->x->raster_x;
        from[n][1] = lab->x->raster_y;
        row[n] = step(lab, &sampler, &rng, &moved);
        accepted += moved;
        pixels += !seen[lab->x->pixel];
        seen[lab->x->pixel] = true;
        to[n][0] = lab->x->raster_x;
        to[n][1] = lab->x->raster_y;
        n += to[n][0] != from[n][0] || to[n][1] != from[n][1];
    }
    fprintf(out, "<text x='0' y='-6'>%s, %s: %d of %d accepted, %d pixel%s</text>\n", scene, name, accepted, (int)MOVES, pixels, pixels == 1 ? "" : "s");
    draw_film(out, lab);
    for (int r = 0; r < MUTATIONS; r++) {
        fprintf(out, "<path fill='none' stroke='%s' stroke-width='0.7' stroke-opacity='0.75' d='", colour[r]);
        for (int i = 0; i < n; i++)
            if (row[i] == r) {
                if (i == 0 || row[i - 1] != r) fprintf(out, "M%.1f %.1f", PANEL * from[i][0], PANEL * from[i][1]);
                fprintf(out, "L%.1f %.1f", PANEL * to[i][0], PANEL * to[i][1]);
            }
        fputs("'/>\n", out);
    }
    fprintf(out, "<circle cx='%.1f' cy='%.1f' r='4' fill='none' stroke='#000' stroke-width='1.5'/>\n", PANEL * start_x, PANEL * start_y);
    fprintf(out, "<rect width='%d' height='%d' fill='none' stroke='#444'/>\n", FILM_WIDTH * PANEL, FILM_HEIGHT * PANEL);
    return true;
}

static bool draw_traces(FILE *out, Lab *lab, int n)
{
    static const struct { const char *name; unsigned allowed; } set[] = { { "bidir alone", 1 }, { "all", ~0u } };
    int width = 2 * (FILM_WIDTH * PANEL + GAP) + GAP, across = FILM_WIDTH * PANEL + GAP, down = FILM_HEIGHT * PANEL + HEAD;
    fprintf(out, "<svg xmlns='http://www.w3.org/2000/svg' width='%d' height='%d' viewBox='0 0 %d %d' font-family='sans-serif' font-size='12'>\n"
                 "<rect width='100%%' height='100%%' fill='white'/>\n", width, n * down + FOOT, width, n * down + FOOT);
    bool ok = true;
    for (int s = 0; s < n; s++)
        for (int i = 0; i < 2; i++) {
            fprintf(out, "<g transform='translate(%d %d)'>\n", GAP + i * across, HEAD + s * down);
            ok = ok && draw_trace(out, &lab[s], scene_name[s], set[i].name, set[i].allowed);
            fputs("</g>\n", out);
        }
    for (int r = 0; r < MUTATIONS; r++)
        fprintf(out, "<line x1='%d' y1='%d' x2='%d' y2='%d' stroke='%s' stroke-width='2'/><text x='%d' y='%d'>%s</text>\n", GAP + 110 * r, n * down + 16, GAP + 110 * r + 24, n * down + 16,
                colour[r], GAP + 110 * r + 30, n * down + 20, mutation_table[r].name);
    fputs("</svg>\n", out);
    return ok;
}

/* Proposals of a step that came to nothing count too. */
static void draw_acceptance(FILE *out, Lab *lab, const char *scene)
{
    static double proposed[MUTATIONS][LENGTHS], accepted[MUTATIONS][LENGTHS], share[MUTATIONS][LENGTHS], length[LENGTHS];
    memset(proposed, 0, sizeof proposed);
    memset(accepted, 0, sizeof accepted);
    Sampler sampler = sampler_for(&lab->scene, ~0u);
    Rng rng = rng_new(4, 0);
    for (int c = 0; c < CHAINS; c++) {
        if (!bootstrap_seed(&lab->boot, &lab->space, lab->bdpt, even(0.3, (uint64_t)c, 0), lab->x)) return;
        for (int i = 0; i < STEPS; i++) {
            int k = lab->x->k;
            bool moved;
            int r = step(lab, &sampler, &rng, &moved);
            if (k >= LENGTHS) continue;
            proposed[r][k]++;
            accepted[r][k] += moved;
        }
    }
    SvgSeries series[MUTATIONS];
    int n = 0, longest = 0;
    for (int k = 0; k < LENGTHS; k++) length[k] = k;
    for (int r = 0; r < MUTATIONS; r++) {
        double all = 0;
        for (int k = 0; k < LENGTHS; k++) {
            share[r][k] = proposed[r][k] >= ENOUGH ? accepted[r][k] / proposed[r][k] : NAN;
            if (proposed[r][k] < ENOUGH) continue;
            all += proposed[r][k];
            if (k > longest) longest = k;
            printf("%s,%s,%d,%.0f,%.4f\n", scene, mutation_table[r].name, k, proposed[r][k], share[r][k]);
        }
        if (all > 0) series[n++] = (SvgSeries){ mutation_table[r].name, LENGTHS, length, share[r] };
    }
    for (int i = 0; i < n; i++) series[i].count = longest + 1;
    char title[100];
    snprintf(title, sizeof title, "%s: accepted of those proposed", scene);
    svg_plot(out, &(SvgPlot){ .title = title, .x_label = "edges of the path", .y_label = "share accepted", .count = n, .series = series });
}

static bool open_lab(Lab *lab, const char *name, Report *report)
{
    char path[100];
    snprintf(path, sizeof path, "scenes/%s.obj", name);
    CameraSettings film = { .has_size = true, .width = FILM_WIDTH, .height = FILM_HEIGHT };
    if (!scene_load(&lab->scene, path, &film, BVH_FAST, report)) return false;
    lab->space = (Space){ .scene = &lab->scene, .max_depth = 64, .direct = DIRECT_EXCLUDED };
    lab->bdpt = bdpt_new();
    lab->x = malloc(sizeof *lab->x);
    lab->y = malloc(sizeof *lab->y);
    return (lab->bdpt && lab->x && lab->y && bootstrap_run(&lab->boot, &lab->space, lab->bdpt, STARTS, 1, 0)) || report_error(report, NULL, 0, "out of memory");
}

static FILE *open_file(const char *folder, const char *name)
{
    char path[1024];
    FILE *out = snprintf(path, sizeof path, "%s/%s.svg", folder, name) < (int)sizeof path ? fopen(path, "w") : NULL;
    if (!out) fprintf(stderr, "trace: cannot write %s/%s.svg\n", folder, name);
    return out;
}

static bool close_file(FILE *out)
{
    bool ok = !ferror(out);
    return (fclose(out) == 0) & ok;
}

int main(int argc, char **argv)
{
    if (argc != 2) { fputs("usage: trace FOLDER\n", stderr); return 2; }
    static Lab lab[SCENES];
    Report report = { .warnings = stderr };
    for (int s = 0; s < SCENES; s++)
        if (!open_lab(&lab[s], scene_name[s], &report)) { fprintf(stderr, "trace: %s\n", report.error); return 1; }
    FILE *out = open_file(argv[1], "trace");
    bool ok = out && draw_traces(out, lab, SCENES);
    if (out) ok = close_file(out) && ok;
    puts("scene,strategy,edges,proposed,accepted");
    for (int s = 0; s < SCENES; s++) {
        char name[100];
        snprintf(name, sizeof name, "acceptance-%s", scene_name[s]);
        if (!(out = open_file(argv[1], name))) return 1;
        draw_acceptance(out, &lab[s], scene_name[s]);
        ok = close_file(out) && ok;
        bootstrap_free(&lab[s].boot);
        bdpt_free(lab[s].bdpt);
        free(lab[s].x);
        free(lab[s].y);
        scene_free(&lab[s].scene);
    }
    return !ok;
}
