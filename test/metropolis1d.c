/* The Metropolis algorithm on a function of one number: all that mlt.c does, without paths.
 *
 *     metropolis1d [--svg FILE]
 *
 * Wanted: how much of f lies in each of 20 bins of [0,1]. f can be evaluated, its integral is not known to the algorithm. A table shows what the
 * size of the steps does, and what expected values are worth. Then checks, among them two planted faults. */
#include "check.h"
#include "rng.h"
#include "svgplot.h"
#include <string.h>

enum { BINS = 20, STARTS = 1000, STEPS = 1000, RUNS = 1000, SIZES = 11 };

/* A wide bump, a narrow one twice as high, and nearly nothing between: as light on a wall and a caustic. */
static double f(double x)
{
    double wide = (x - 0.3) / 0.1, narrow = (x - 0.75) / 0.03;
    return exp(-0.5 * wide * wide) + 2 * exp(-0.5 * narrow * narrow) + 0.02;
}

/* Integral of f over [low, high], by Simpson's rule: what the histogram must come to. */
static double integral(double low, double high)
{
    enum { N = 200 };
    double h = (high - low) / N, sum = f(low) + f(high);
    for (int i = 1; i < N; i++) sum += f(low + h * i) * (i % 2 ? 4 : 2);
    return sum * h / 3;
}

/* The last two are planted faults. */
typedef enum { RIGHT, NO_RATIO, CLAMPED } Acceptance;

static double accept_probability(double f_x, double f_y, Acceptance rule)
{
    if (!(f_y > 0)) return 0;
    if (rule == NO_RATIO) return 1;                /* goes wherever there is light */
    double a = f_y < f_x ? f_y / f_x : 1;          /* T(y|x) = T(x|y), so that f is all that is left of the ratio */
    return rule == CLAMPED && a < 0.1 ? 0.1 : a;   /* 'so that the chain does not get stuck' */
}

static int bin_of(double x) { return (int)(x * BINS); }

/* One run. Adds b^ times the share of each bin, without and with expected values; returns the share of proposals accepted. */
static double run(double size, Acceptance rule, Rng *rng, double plain[BINS], double expected[BINS])
{
    /* b^: mean weight f/p of independent samples, here p = 1. The chain starts from one of them, drawn in proportion to its weight. Then
     * the expectation of b^ * histogram is exact from the first step on; nothing has to be thrown away. */
    double start[STARTS], sum[STARTS], total = 0;
    for (int i = 0; i < STARTS; i++) {
        start[i] = rng_double(rng);
        sum[i] = total += f(start[i]) / 1;
    }
    double b = total / STARTS, target = rng_double(rng) * total;
    int seed = 0;
    while (seed < STARTS - 1 && sum[seed] <= target) seed++;

    double x = start[seed], f_x = f(x), unit = b / STEPS;
    int accepted = 0;
    for (int step = 0; step < STEPS; step++) {
        double y = x + size * (2 * rng_double(rng) - 1);                       /* Mutate: as likely there as back */
        double f_y = y >= 0 && y < 1 ? f(y) : 0, a = accept_probability(f_x, f_y, rule);
        /* expected values: both places, each with its chance, whichever the dice choose */
        expected[bin_of(x)] += unit * (1 - a);
        if (a > 0) expected[bin_of(y)] += unit * a;
        if (rng_double(rng) < a) {
            x = y;
            f_x = f_y;
            accepted++;
        }
        plain[bin_of(x)] += unit;                  /* also after a rejection: the old x counts again */
    }
    return (double)accepted / STEPS;
}

/* Over many runs: acceptance, error (root mean square over runs and bins, relative to the mean bin), and whether the mean is f. */
typedef struct { double acceptance, plain_error, expected_error, worst_z; } Result;

static Result measure(double size, Acceptance rule)
{
    Result r = { 0, 0, 0, 0 };
    double mean[BINS] = { 0 }, square[BINS] = { 0 }, plain_square = 0, expected_square = 0, average = integral(0, 1) / BINS;
    for (uint64_t i = 0; i < RUNS; i++) {
        Rng rng = rng_new(1, i);
        double plain[BINS] = { 0 }, expected[BINS] = { 0 };
        r.acceptance += run(size, rule, &rng, plain, expected) / RUNS;
        for (int k = 0; k < BINS; k++) {
            double truth = integral((double)k / BINS, (k + 1.0) / BINS), d = expected[k] - truth;
            plain_square += (plain[k] - truth) * (plain[k] - truth);
            expected_square += d * d;
            mean[k] += d / RUNS;
            square[k] += d * d / RUNS;
        }
    }
    r.plain_error = sqrt(plain_square / (RUNS * BINS)) / average;
    r.expected_error = sqrt(expected_square / (RUNS * BINS)) / average;
    for (int k = 0; k < BINS; k++) check_worse(&r.worst_z, fabs(mean[k]) / sqrt((square[k] - mean[k] * mean[k]) / (RUNS - 1)));
    return r;
}

int main(int argc, char **argv)
{
    static const double size[SIZES] = { 0.003, 0.006, 0.0125, 0.025, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1 };
    double acceptance[SIZES], plain[SIZES], expected[SIZES];
    int best = 0, eager = 0;                       /* lowest error; highest acceptance */
    printf("%d runs of %d steps\n\n   step  accepted   error  with expected values  |z|\n", RUNS, STEPS);
    for (int i = 0; i < SIZES; i++) {
        Result r = measure(size[i], RIGHT);
        acceptance[i] = r.acceptance;
        plain[i] = r.plain_error;
        expected[i] = r.expected_error;
        printf("%7.4f  %8.3f  %6.3f  %20.3f  %3.1f\n", size[i], acceptance[i], plain[i], expected[i], r.worst_z);
        if (expected[i] < expected[best]) best = i;
        if (acceptance[i] > acceptance[eager]) eager = i;
        CHECK(r.worst_z < 5);                      /* 220 comparisons in all: a false alarm once in eight thousand */
        CHECK(expected[i] < plain[i] * 1.0005);    /* never worth less; where nearly all is accepted, hardly more */
    }
    printf("\nhighest acceptance at step %g, lowest error at step %g\n", size[eager], size[best]);
    CHECK(best != eager);
    CHECK(expected[best] < 0.5 * expected[eager]);
    CHECK(acceptance[best] < 0.6);
    CHECK(expected[best] < 0.97 * plain[best]);

    double no_ratio = measure(0.2, NO_RATIO).worst_z, clamped = measure(0.2, CLAMPED).worst_z;
    printf("planted: acceptance without the ratio |z| %.0f, never below 0.1 |z| %.0f\n", no_ratio, clamped);
    CHECK(no_ratio > 20);
    CHECK(clamped > 20);

    if (argc == 3 && strcmp(argv[1], "--svg") == 0) {
        SvgSeries series[] = { { "error", SIZES, size, plain }, { "with expected values", SIZES, size, expected }, { "acceptance", SIZES, size, acceptance } };
        SvgPlot plot = { .title = "1000 steps on two bumps", .x_label = "largest step", .y_label = "relative error; share accepted",
                         .x_log = true, .y_log = true, .count = 3, .series = series };
        FILE *out = fopen(argv[2], "w");
        if (CHECK(out != NULL)) {
            svg_plot(out, &plot);
            CHECK(!ferror(out));
            CHECK(fclose(out) == 0);
        }
    }
    return check_report();
}
