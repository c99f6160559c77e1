/* Line plots as SVG, for what the benchmarks and the documents show. Axes linear or logarithmic, chosen to hold all points.
 *
 * Knows nothing of where the numbers come from. */
#ifndef SVGPLOT_H
#define SVGPLOT_H
#include <stdbool.h>
#include <stdio.h>

typedef struct {
    const char *name;              /* in the legend */
    int count;
    const double *x, *y;           /* [count]; a point that is not finite, or not positive on a logarithmic axis, is left out and breaks the line */
} SvgSeries;

typedef struct {
    const char *title, *x_label, *y_label;     /* UTF-8; NULL for none */
    bool x_log, y_log;
    int count;
    const SvgSeries *series;       /* [count] */
    bool guide;                    /* a dashed line of this slope through the first point drawn: decades by decades if both axes */
    double guide_slope;            /* are logarithmic, y by x if neither is; not for a mixed plot */
    const char *guide_name;        /* in the legend; NULL for none */
} SvgPlot;

/* Errors of writing are left to ferror(out). */
void svg_plot(FILE *out, const SvgPlot *plot);
#endif
