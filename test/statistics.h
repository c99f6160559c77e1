/* Whether two groups of independent runs have the same mean (Welch's test), and whether counts are what they should be (chi-square). */
#ifndef STATISTICS_H
#define STATISTICS_H
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

/* Mean of n values that stand 'stride' apart, and the variance of that mean. */
static inline void mean_and_variance(const double *value, int stride, int n, double *mean, double *variance)
{
    double sum = 0, squares = 0;
    for (int i = 0; i < n; i++) sum += value[i * stride];
    *mean = sum / n;
    for (int i = 0; i < n; i++) squares += (value[i * stride] - *mean) * (value[i * stride] - *mean);
    *variance = squares / (n - 1) / n;
}

/* Chance of means so far apart, NaN if any number is one; *t receives the difference in standard errors. The variances are those of the means, of 'runs' runs each. */
static inline double welch_chance(double mean_a, double variance_a, int runs_a, double mean_b, double variance_b, int runs_b, double *t)
{
    double variance = variance_a + variance_b, difference = fabs(mean_a - mean_b);
    *t = difference / sqrt(variance);
    if (variance == 0) return difference > 0 ? 0 : 1;
    return student_tail(*t, variance * variance / (variance_a * variance_a / (runs_a - 1) + variance_b * variance_b / (runs_b - 1)));
}

/* A chi-square as a normal deviate [Wilson and Hilferty]. */
static inline double chi_square_deviate(double chi_square, int freedom)
{
    double v = 2 / (9.0 * freedom);
    return (cbrt(chi_square / freedom) - 1 + v) / sqrt(v);
}
#endif
