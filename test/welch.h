/* Welch's test: whether two groups of independent runs have the same mean. */
#ifndef WELCH_H
#define WELCH_H
#include <math.h>

/* Chance that |t| of Student's distribution is larger: t = sqrt(freedom) tan(angle), the density goes as cos^(freedom - 1). */
static inline double student_tail(double t, double freedom)
{
    const double right_angle = 1.57079632679489661923;
    double start = atan(t / sqrt(freedom)), tail = 0, all = 0;
    enum { STEPS = 2000 };
    for (int i = 0; i < STEPS; i++) {
        double u = (i + 0.5) / STEPS;
        tail += (right_angle - start) * pow(cos(start + (right_angle - start) * u), freedom - 1);
        all += right_angle * pow(cos(right_angle * u), freedom - 1);
    }
    return tail / all;
}

/* Chance of means so far apart; *t receives the difference in standard errors. The variances are those of the means, of 'runs' runs each. */
static inline double welch_chance(double mean_a, double variance_a, int runs_a, double mean_b, double variance_b, int runs_b, double *t)
{
    double variance = variance_a + variance_b, difference = fabs(mean_a - mean_b);
    *t = difference / sqrt(variance);
    if (!(variance > 0)) return difference > 0 ? 0 : 1;
    return student_tail(*t, variance * variance / (variance_a * variance_a / (runs_a - 1) + variance_b * variance_b / (runs_b - 1)));
}
#endif
