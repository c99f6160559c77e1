/* What test/bench_error.sh has measured, as tables and plots.
 *
 *     bench_plot FILE.csv FOLDER
 *
 * FILE.csv has lines scene,way,seconds,seed,relmse. For each scene a Markdown table of the mean relMSE over seeds with its standard error, and,
 * where there are several budgets, the slope of log(mean) against log(seconds) by least squares: relMSE is a mean of squares, so that
 * independent samples have -1 (-1/2 for its root). The standard error of the slope is found by leaving one seed out at a time. Then
 * FOLDER/error-SCENE.svg, with a line of slope -1. The way 'reference' is the reference's own estimate of its relMSE. */
#include "svgplot.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { NAME = 32, SCENES = 16, WAYS = 16, BUDGETS = 16, SEEDS = 256 };

typedef struct { char name[NAME]; int runs[BUDGETS]; double relmse[BUDGETS][SEEDS]; } Way;
typedef struct { char name[NAME]; int ways; Way way[WAYS]; double reference, reference_seconds; } Measured;

static double budget[BUDGETS];
static int budgets;

/* Place of a name in a list, added at its end if it is new; -1 if the list is full. */
static int find(void *list, size_t size, int *count, int room, const char *name)
{
    char *at = list;                               /* names come first in each element */
    for (int i = 0; i < *count; i++)
        if (strcmp(at + size * (size_t)i, name) == 0) return i;
    if (*count == room) return -1;
    snprintf(at + size * (size_t)*count, NAME, "%s", name);
    return (*count)++;
}

static int find_budget(double seconds)
{
    int i = 0;
    while (i < budgets && budget[i] < seconds) i++;
    if (i < budgets && budget[i] == seconds) return i;
    return -1;
}

/* Ascending, so that budgets stand in order before anything is put into them. */
static bool add_budget(double seconds)
{
    if (find_budget(seconds) >= 0) return true;
    if (budgets == BUDGETS) return false;
    int i = budgets++;
    for (; i > 0 && budget[i - 1] > seconds; i--) budget[i] = budget[i - 1];
    budget[i] = seconds;
    return true;
}

typedef struct { char scene[NAME], way[NAME]; double seconds, relmse; } Row;

static bool read_row(FILE *in, Row *row)
{
    char line[256];
    while (fgets(line, sizeof line, in))
        if (sscanf(line, "%31[^,],%31[^,],%lf,%*d,%lf", row->scene, row->way, &row->seconds, &row->relmse) == 4) return true;
    return false;
}

/* False if it does not fit. */
static bool read_all(FILE *in, Measured *scene, int *scenes)
{
    Row row;
    while (read_row(in, &row))
        if (strcmp(row.way, "reference") != 0 && !add_budget(row.seconds)) return false;
    rewind(in);
    while (read_row(in, &row)) {
        int s = find(scene, sizeof *scene, scenes, SCENES, row.scene);
        if (s < 0) return false;
        if (strcmp(row.way, "reference") == 0) {
            scene[s].reference = row.relmse;
            scene[s].reference_seconds = row.seconds;
            continue;
        }
        int w = find(scene[s].way, sizeof *scene[s].way, &scene[s].ways, WAYS, row.way), b = find_budget(row.seconds);
        if (w < 0 || scene[s].way[w].runs[b] == SEEDS) return false;
        Way *way = &scene[s].way[w];
        way->relmse[b][way->runs[b]++] = row.relmse;
    }
    return true;
}

/* Mean over the seeds of a budget but one; -1 leaves none out. NAN if there is none. */
static double mean(const Way *way, int b, int without)
{
    double sum = 0;
    int n = 0;
    for (int i = 0; i < way->runs[b]; i++)
        if (i != without) sum += way->relmse[b][i], n++;
    return n > 0 ? sum / n : NAN;
}

static double standard_error(const Way *way, int b)
{
    double m = mean(way, b, -1), sum = 0;
    int n = way->runs[b];
    for (int i = 0; i < n; i++) sum += (way->relmse[b][i] - m) * (way->relmse[b][i] - m);
    return n > 1 ? sqrt(sum / (n - 1) / n) : NAN;
}

static double slope(const Way *way, int without)
{
    double n = 0, x = 0, y = 0, xx = 0, xy = 0;
    for (int b = 0; b < budgets; b++) {
        double u = log(budget[b]), v = log(mean(way, b, without));
        if (!isfinite(v)) continue;
        n++, x += u, y += v, xx += u * u, xy += u * v;
    }
    return n > 1 ? (n * xy - x * y) / (n * xx - x * x) : NAN;
}

static double slope_error(const Way *way)
{
    int n = SEEDS;
    double sum = 0, squares = 0;
    for (int b = 0; b < budgets; b++) n = way->runs[b] < n ? way->runs[b] : n;
    for (int i = 0; i < n; i++) {
        double s = slope(way, i);
        sum += s;
        squares += s * s;
    }
    return n > 1 ? sqrt((n - 1.0) / n * fmax(0, squares - sum * sum / n)) : NAN;
}

static void print_table(const Measured *s)
{
    printf("\n| %s |", s->name);
    for (int b = 0; b < budgets; b++) printf(" %g s |", budget[b]);
    puts(budgets > 1 ? " slope |" : "");
    for (int b = 0; b <= budgets + (budgets > 1); b++) printf(b ? " --- |" : "| --- |");
    puts("");
    for (int w = 0; w < s->ways; w++) {
        const Way *way = &s->way[w];
        printf("| %s |", way->name);
        for (int b = 0; b < budgets; b++) printf(" %.3g ± %.1g |", mean(way, b, -1), standard_error(way, b));
        if (budgets > 1) printf(" %.2f ± %.2f |", slope(way, -1), slope_error(way));
        puts("");
    }
    if (s->reference > 0) printf("\nThe reference, of %.0f s, puts its own relMSE at %.2g.\n", s->reference_seconds, s->reference);
}

static bool draw(const Measured *s, const char *folder)
{
    static double value[WAYS][BUDGETS];
    SvgSeries series[WAYS];
    char path[1024], title[100];
    for (int w = 0; w < s->ways; w++) {
        for (int b = 0; b < budgets; b++) value[w][b] = mean(&s->way[w], b, -1);
        series[s->ways - 1 - w] = (SvgSeries){ s->way[w].name, budgets, budget, value[w] };   /* the guide goes through the last way's first point */
    }
    snprintf(title, sizeof title, "%s: error against time", s->name);
    FILE *out = snprintf(path, sizeof path, "%s/error-%s.svg", folder, s->name) < (int)sizeof path ? fopen(path, "w") : NULL;
    if (!out) return false;
    svg_plot(out, &(SvgPlot){ .title = title, .x_label = "seconds, loading and start-up included", .y_label = "relMSE", .x_log = true, .y_log = true,
                              .count = s->ways, .series = series, .guide = true, .guide_slope = -1, .guide_name = "slope -1 (RMSE: -1/2)" });
    bool ok = !ferror(out);
    return (fclose(out) == 0) & ok;
}

int main(int argc, char **argv)
{
    if (argc != 3) { fputs("usage: bench_plot FILE.csv FOLDER\n", stderr); return 2; }
    static Measured scene[SCENES];
    int scenes = 0;
    FILE *in = fopen(argv[1], "r");
    if (!in || !read_all(in, scene, &scenes)) { fprintf(stderr, "bench_plot: cannot read %s\n", argv[1]); return 1; }
    fclose(in);
    bool ok = true;
    for (int s = 0; s < scenes; s++) {
        print_table(&scene[s]);
        if (budgets > 1) ok &= draw(&scene[s], argv[2]);
    }
    if (!ok) fprintf(stderr, "bench_plot: cannot write to %s\n", argv[2]);
    return !ok;
}
