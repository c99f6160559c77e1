/* See svgplot.h. A plot is drawn in a box of fixed size; an axis maps values, or their decimal logarithms, to it. */
#include "svgplot.h"
#include <math.h>

enum { WIDTH = 640, HEIGHT = 420, LEFT = 72, RIGHT = 20, TOP = 40, BOTTOM = 54, LEGEND_LINE = 18, LEGEND_WIDTH = 164, TICKS = 6 };

typedef struct {
    bool log;
    double low, high;              /* ends of the axis; logarithms on a logarithmic one */
    double begin, end;             /* where they are in the picture */
    double step;                   /* from tick to tick */
} Axis;

/* NaN if v has no place on the axis. */
static double axis_value(const Axis *a, double v) { return a->log ? (v > 0 ? log10(v) : NAN) : v; }
static double axis_place(const Axis *a, double value) { return a->begin + (value - a->low) / (a->high - a->low) * (a->end - a->begin); }

/* The distance of ticks: 1, 2 or 5 times a power of ten, and whole decades on a logarithmic axis. */
static double axis_step(const Axis *a)
{
    double rough = (a->high - a->low) / TICKS, power = pow(10, floor(log10(rough))), step = rough / power;
    step = power * (step <= 1 ? 1 : step <= 2 ? 2 : step <= 5 ? 5 : 10);
    return a->log ? fmax(1, ceil(step)) : step;
}

/* Both ends moved out to a tick. */
static void axis_fit(Axis *a)
{
    if (!(a->low <= a->high)) a->low = 0, a->high = 1;                      /* nothing to show */
    if (a->low == a->high) a->low -= a->log ? 0.5 : 0.5 * fabs(a->low) + 1e-9, a->high += a->log ? 0.5 : 0.5 * fabs(a->high) + 1e-9;
    double step = a->step = axis_step(a);
    a->low = step * floor(a->low / step + 1e-9);
    a->high = step * ceil(a->high / step - 1e-9);
}

static bool point(const SvgSeries *s, int i, const Axis *x, const Axis *y, double *at_x, double *at_y)
{
    *at_x = axis_value(x, s->x[i]);
    *at_y = axis_value(y, s->y[i]);
    return isfinite(*at_x) && isfinite(*at_y);
}

static void text(FILE *out, double x, double y, const char *attributes, const char *words)
{
    fprintf(out, "<text x='%.1f' y='%.1f' %s>", x, y, attributes);
    for (; words && *words; words++) {
        if (*words == '<') fputs("&lt;", out);
        else if (*words == '&') fputs("&amp;", out);
        else fputc(*words, out);
    }
    fputs("</text>\n", out);
}

static void line(FILE *out, double x1, double y1, double x2, double y2, const char *attributes)
{
    fprintf(out, "<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' %s/>\n", x1, y1, x2, y2, attributes);
}

static void draw_axis(FILE *out, const Axis *a, bool upright)
{
    double step = a->step;
    for (int i = 0; a->low + i * step <= a->high + 1e-6 * step; i++) {
        double value = a->low + i * step, at = axis_place(a, value);
        char label[40];
        if (fabs(value) < 1e-9 * step) value = 0;
        if (!a->log) snprintf(label, sizeof label, "%.6g", value);
        else if (fabs(value) <= 3) snprintf(label, sizeof label, "%g", pow(10, value));
        else snprintf(label, sizeof label, "1e%.0f", value);
        if (upright) line(out, LEFT, at, WIDTH - RIGHT, at, "stroke='#ddd'");
        else line(out, at, TOP, at, HEIGHT - BOTTOM, "stroke='#ddd'");
        text(out, upright ? LEFT - 8 : at, upright ? at + 4 : HEIGHT - BOTTOM + 18, upright ? "text-anchor='end'" : "text-anchor='middle'", label);
        /* The 2..9 of each decade as short marks. */
        for (int digit = 2; a->log && digit <= 9 && step < 1.5 && value < a->high - 0.5; digit++) {
            at = axis_place(a, value + log10(digit));
            if (upright) line(out, LEFT, at, LEFT + 4, at, "stroke='#888'");
            else line(out, at, HEIGHT - BOTTOM, at, HEIGHT - BOTTOM - 4, "stroke='#888'");
        }
    }
}

static void draw_marker(FILE *out, int series, double x, double y, const char *colour)
{
    switch (series % 4) {
    case 0: fprintf(out, "<circle cx='%.1f' cy='%.1f' r='3.5' fill='%s'/>\n", x, y, colour); break;
    case 1: fprintf(out, "<rect x='%.1f' y='%.1f' width='6.4' height='6.4' fill='%s'/>\n", x - 3.2, y - 3.2, colour); break;
    case 2: fprintf(out, "<path d='M%.1f %.1fl4.2 7.4h-8.4z' fill='%s'/>\n", x, y - 4.6, colour); break;
    default: fprintf(out, "<path d='M%.1f %.1fl4.4 4.4l-4.4 4.4l-4.4 -4.4z' fill='%s'/>\n", x, y - 4.4, colour); break;
    }
}

/* How much of the lines lies in a rectangle, in twentieths of a line from point to point. */
static int lines_in(const SvgPlot *plot, const Axis *x, const Axis *y, double left, double top, double right, double bottom)
{
    int n = 0;
    for (int s = 0; s < plot->count; s++) {
        for (int i = 0; i < plot->series[s].count; i++) {
            double x0, y0, x1, y1;
            if (!point(&plot->series[s], i, x, y, &x0, &y0)) continue;
            if (i == 0 || !point(&plot->series[s], i - 1, x, y, &x1, &y1)) x1 = x0, y1 = y0;
            for (int k = 0; k < 20; k++) {
                double at_x = axis_place(x, x0 + k / 20.0 * (x1 - x0)), at_y = axis_place(y, y0 + k / 20.0 * (y1 - y0));
                n += at_x > left && at_x < right && at_y > top && at_y < bottom;
            }
        }
    }
    return n;
}

void svg_plot(FILE *out, const SvgPlot *plot)
{
    /* Colours that are told apart with any colour vision; source: Okabe and Ito. */
    static const char *const colours[] = { "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000" };
    Axis x = { plot->x_log, INFINITY, -INFINITY, LEFT, WIDTH - RIGHT, 1 }, y = { plot->y_log, INFINITY, -INFINITY, HEIGHT - BOTTOM, TOP, 1 };
    double first_x = NAN, first_y = NAN, at_x, at_y;
    for (int s = 0; s < plot->count; s++) {
        for (int i = 0; i < plot->series[s].count; i++) {
            if (!point(&plot->series[s], i, &x, &y, &at_x, &at_y)) continue;
            if (isnan(first_x)) first_x = at_x, first_y = at_y;
            x.low = fmin(x.low, at_x), x.high = fmax(x.high, at_x);
            y.low = fmin(y.low, at_y), y.high = fmax(y.high, at_y);
        }
    }
    axis_fit(&x);
    axis_fit(&y);

    fprintf(out, "<svg xmlns='http://www.w3.org/2000/svg' width='%d' height='%d' viewBox='0 0 %d %d' font-family='sans-serif' font-size='12'>\n"
        "<rect width='%d' height='%d' fill='white'/>\n<clipPath id='box'><rect x='%d' y='%d' width='%d' height='%d'/></clipPath>\n",
        WIDTH, HEIGHT, WIDTH, HEIGHT, WIDTH, HEIGHT, LEFT, TOP, WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
    draw_axis(out, &x, false);
    draw_axis(out, &y, true);
    fprintf(out, "<rect x='%d' y='%d' width='%d' height='%d' fill='none' stroke='#444'/>\n", LEFT, TOP, WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM);
    text(out, (LEFT + WIDTH - RIGHT) / 2.0, 24, "text-anchor='middle' font-size='15'", plot->title);
    text(out, (LEFT + WIDTH - RIGHT) / 2.0, HEIGHT - 12, "text-anchor='middle'", plot->x_label);
    text(out, -(TOP + HEIGHT - BOTTOM) / 2.0, 18, "text-anchor='middle' transform='rotate(-90)'", plot->y_label);

    static const char dashed[] = "stroke='#666' stroke-dasharray='6 4' clip-path='url(#box)'";
    bool guide = plot->guide && plot->x_log == plot->y_log && isfinite(first_x);
    if (guide)
        line(out, x.begin, axis_place(&y, first_y + plot->guide_slope * (x.low - first_x)),
            x.end, axis_place(&y, first_y + plot->guide_slope * (x.high - first_x)), dashed);
    for (int s = 0; s < plot->count; s++) {
        const SvgSeries *series = &plot->series[s];
        const char *colour = colours[(size_t)s % (sizeof colours / sizeof *colours)];
        bool drawing = false;
        fprintf(out, "<path fill='none' stroke='%s' stroke-width='1.8' d='", colour);
        for (int i = 0; i < series->count; i++) {
            bool here = point(series, i, &x, &y, &at_x, &at_y);
            if (here) fprintf(out, "%c%.1f %.1f", drawing ? 'L' : 'M', axis_place(&x, at_x), axis_place(&y, at_y));
            drawing = here;
        }
        fprintf(out, "'/>\n");
        for (int i = 0; i < series->count; i++)
            if (point(series, i, &x, &y, &at_x, &at_y)) draw_marker(out, s, axis_place(&x, at_x), axis_place(&y, at_y), colour);
    }

    /* The legend, in the corner where it hides least. */
    int rows = plot->count + (guide && plot->guide_name), least = 0;
    double legend_x = 0, legend_y = 0, high = rows * LEGEND_LINE + 6;
    for (int corner = 0; corner < 4; corner++) {
        double left = corner % 2 ? LEFT + 8 : WIDTH - RIGHT - LEGEND_WIDTH - 6, top = corner / 2 ? HEIGHT - BOTTOM - high - 6 : TOP + 4;
        int hidden = lines_in(plot, &x, &y, left, top, left + LEGEND_WIDTH, top + high);
        if (corner == 0 || hidden < least) legend_x = left, legend_y = top, least = hidden;
    }
    if (rows > 0)
        fprintf(out, "<rect x='%.1f' y='%.1f' width='%d' height='%.1f' fill='white' fill-opacity='0.85'/>\n",
            legend_x, legend_y, LEGEND_WIDTH, high);
    legend_y += LEGEND_LINE - 4;
    for (int row = 0; row < rows; row++, legend_y += LEGEND_LINE) {
        const char *colour = colours[(size_t)row % (sizeof colours / sizeof *colours)];
        char stroke[60];
        snprintf(stroke, sizeof stroke, "stroke='%s' stroke-width='1.8'", colour);
        line(out, legend_x + 6, legend_y, legend_x + 30, legend_y, row < plot->count ? stroke : "stroke='#666' stroke-dasharray='6 4'");
        if (row < plot->count) draw_marker(out, row, legend_x + 18, legend_y, colour);
        text(out, legend_x + 36, legend_y + 4, "", row < plot->count ? plot->series[row].name : plot->guide_name);
    }
    fputs("</svg>\n", out);
}
