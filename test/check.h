/* CHECK and CHECK_NEAR: print file, line, expression and both values of what fails, count, and close with 'N passed, N failed'.
 * A test program ends with 'return check_report();', which is non-zero if anything failed, or nothing was checked. */
#ifndef CHECK_H
#define CHECK_H
#include <math.h>
#include <stdio.h>

static int check_passed, check_failed;

static inline int check_count(int ok)
{
    if (ok) check_passed++;
    else check_failed++;
    return ok;
}

#define CHECK(expression) \
    (check_count(!!(expression)) ? 1 : (printf("%s:%d: failed: %s\n", __FILE__, __LINE__, #expression), 0))

/* |a - b| <= tolerance; false for NaN */
#define CHECK_NEAR(a, b, tolerance) check_near((a), (b), (tolerance), #a, #b, __FILE__, __LINE__)

static inline int check_near(double a, double b, double tolerance, const char *a_text, const char *b_text, const char *file, int line)
{
    if (check_count(fabs(a - b) <= tolerance)) return 1;
    printf("%s:%d: failed: %s = %.17g, %s = %.17g, apart by %.3g, allowed %.3g\n", file, line, a_text, a, b_text, b, fabs(a - b), tolerance);
    return 0;
}

/* The largest difference met so far; a NaN stays, so that the check at the end sees it. */
static inline void check_worse(double *worst, double d)
{
    if (d > *worst || isnan(d)) *worst = d;
}

static inline int check_report(void)
{
    printf("%d passed, %d failed\n", check_passed, check_failed);
    return check_failed != 0 || check_passed == 0;
}
#endif
