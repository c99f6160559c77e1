/* Polygons into triangles: a quad by its better diagonal, a convex polygon as a fan, any other by cutting ears
 * [Meisters, Polygons Have Ears; de Berg et al., Computational Geometry, ch. 3], in the coordinate plane that the polygon faces most.
 *
 * A corner b between a and c is an ear if it is convex and no other corner lies in the triangle (a,b,c). Only reflex corners need to be looked
 * at; they are sorted into a grid, so that only those near the triangle are. */
#include "polygon.h"
#include "vec.h"
#include <stdlib.h>

typedef struct { double x, y; } Point2;

typedef struct {
    Point2 *point;
    uint32_t *previous, *next;         /* ring of the corners that are left */
    bool *reflex, *queued, *gone;
    uint32_t *queue, head, waiting;    /* convex corners to be tried, in a ring buffer */
    uint32_t *cell, *chain;            /* grid: the first reflex corner of each cell, and the next of each corner; NOBODY ends */
    uint32_t columns;                  /* the grid has columns * columns cells */
    Point2 low, per_cell;               /* corner of the grid, cells per length */
    uint64_t budget;                   /* corners and cells that may still be looked at */
} Ring;

static const uint32_t NOBODY = UINT32_MAX;

/* Twice the signed area of (a,b,c), positive if it runs counter-clockwise. */
static double turn(Point2 a, Point2 b, Point2 c)
{
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/* fmin and fmax without their care for NAN, which costs a call. */
static double lesser(double a, double b) { return a < b ? a : b; }
static double greater(double a, double b) { return a > b ? a : b; }

static bool same(Point2 a, Point2 b) { return a.x == b.x && a.y == b.y; }

static Vec3 newell_normal(const float (*position)[3], const uint32_t *corner, uint32_t n)
{
    Vec3 sum = vec3(0, 0, 0), origin = from_float(position[corner[0]]);
    Vec3 a = sub(from_float(position[corner[1]]), origin);
    for (uint32_t i = 2; i < n; i++) {
        Vec3 b = sub(from_float(position[corner[i]]), origin);
        sum = add(sum, cross(a, b));
        a = b;
    }
    return sum;
}

/* Position seen along the axis that the normal is nearest to, such that the polygon runs counter-clockwise. */
static Point2 project(const float p[3], Vec3 normal)
{
    double x = (double)p[0], y = (double)p[1], z = (double)p[2];
    double ax = fabs(normal.x), ay = fabs(normal.y), az = fabs(normal.z);
    Point2 q = az >= ax && az >= ay ? (Point2){ x, y } : ax >= ay ? (Point2){ y, z } : (Point2){ z, x };
    bool away = az >= ax && az >= ay ? normal.z < 0 : ax >= ay ? normal.x < 0 : normal.y < 0;
    return away ? (Point2){ q.y, q.x } : q;
}

/* Of a quad's two diagonals one may lie outside. If both are inside, the shorter bends a quad that is not flat the least; of two that are equal
 * but for rounding, the first. */
static void split_quad(const float (*position)[3], const uint32_t *corner, Vec3 normal, uint32_t (*triangle)[3])
{
    Vec3 p[4];
    for (int i = 0; i < 4; i++) p[i] = from_float(position[corner[i]]);
    Vec3 d02 = sub(p[2], p[0]), d13 = sub(p[3], p[1]);
    bool first = dot(cross(sub(p[1], p[0]), d02), normal) > 0 && dot(cross(d02, sub(p[3], p[0])), normal) > 0;
    bool second = dot(cross(sub(p[2], p[1]), d13), normal) > 0 && dot(cross(d13, sub(p[0], p[1])), normal) > 0;
    uint32_t start = second && (!first || dot(d13, d13) < (1 - 1e-5) * dot(d02, d02)) ? 1 : 0;
    for (uint32_t i = 0; i < 2; i++) {
        triangle[i][0] = start;
        triangle[i][1] = start + i + 1;
        triangle[i][2] = (start + i + 2) % 4;
    }
}

static uint32_t cell_of(double x, uint32_t columns)
{
    return x >= columns ? columns - 1 : x > 0 ? (uint32_t)x : 0;
}

/* A place in units of cells. */
static Point2 in_grid(const Ring *r, Point2 p)
{
    return (Point2){ (p.x - r->low.x) * r->per_cell.x, (p.y - r->low.y) * r->per_cell.y };
}

/* The columns that the triangle g, in units of cells, covers in a row, with a margin for rounding. slope is dx/dy of its edges. */
static void span(const Point2 g[3], const double slope[3], uint32_t row, uint32_t columns, uint32_t *first, uint32_t *last)
{
    static const double margin = 1e-6;
    double left = columns, right = 0, bottom = row - margin, top = row + 1 + margin;
    for (int i = 0; i < 3; i++) {
        Point2 p = g[i], q = g[i < 2 ? i + 1 : 0];
        if (lesser(p.y, q.y) > top || greater(p.y, q.y) < bottom) continue;
        double x0 = p.y < bottom ? p.x + (bottom - p.y) * slope[i] : p.y > top ? p.x + (top - p.y) * slope[i] : p.x;
        double x1 = q.y < bottom ? q.x + (bottom - q.y) * slope[i] : q.y > top ? q.x + (top - q.y) * slope[i] : q.x;
        left = lesser(left, lesser(x0, x1));
        right = greater(right, greater(x0, x1));
    }
    *first = cell_of(left - margin, columns);
    *last = cell_of(right + margin, columns);
}

static bool in_the_way(const Ring *r, uint32_t i, Point2 a, Point2 b, Point2 c)
{
    Point2 p = r->point[i];
    return r->reflex[i] && turn(a, b, p) >= 0 && turn(b, c, p) >= 0 && turn(c, a, p) >= 0 && !same(p, a) && !same(p, b) && !same(p, c);
}

/* Whether a reflex corner other than the three lies in the triangle about corner b or on its border. Corners in the same place as one of the
 * three do not count: bridges to the holes of a polygon run through the same corners twice. */
static bool blocked(Ring *r, uint32_t ia, uint32_t ib, uint32_t ic)
{
    Point2 a = r->point[ia], b = r->point[ib], c = r->point[ic];
    Point2 g[3] = { in_grid(r, a), in_grid(r, b), in_grid(r, c) };
    double slope[3];
    for (int i = 0; i < 3; i++) slope[i] = (g[(i + 1) % 3].x - g[i].x) / (g[(i + 1) % 3].y - g[i].y);        /* used only where it is finite */
    uint32_t bottom = cell_of(lesser(g[0].y, lesser(g[1].y, g[2].y)), r->columns);
    uint32_t top = cell_of(greater(g[0].y, greater(g[1].y, g[2].y)), r->columns);
    if (in_the_way(r, r->previous[ia], a, b, c) || in_the_way(r, r->next[ic], a, b, c)) return true;         /* the likeliest first */
    for (uint32_t row = bottom; row <= top; row++) {
        uint32_t first, last;
        span(g, slope, row, r->columns, &first, &last);
        for (uint32_t column = first; column <= last; column++) {
            if (r->budget == 0) return false;
            r->budget--;
            for (uint32_t *link = &r->cell[row * r->columns + column]; *link != NOBODY;) {
                uint32_t i = *link;
                if (!r->reflex[i]) {                   /* cut off or convex by now: out of the grid */
                    *link = r->chain[i];
                    continue;
                }
                link = &r->chain[i];
                if (r->budget == 0) return false;
                r->budget--;
                if (in_the_way(r, i, a, b, c)) return true;
            }
        }
    }
    return false;
}

static void build_grid(Ring *r, uint32_t n)
{
    Point2 low = { INFINITY, INFINITY }, high = { -INFINITY, -INFINITY };
    for (uint32_t i = 0; i < n; i++) {
        low = (Point2){ lesser(low.x, r->point[i].x), lesser(low.y, r->point[i].y) };
        high = (Point2){ greater(high.x, r->point[i].x), greater(high.y, r->point[i].y) };
    }
    r->low = low;
    r->per_cell = (Point2){ high.x > low.x ? r->columns / (high.x - low.x) : 0, high.y > low.y ? r->columns / (high.y - low.y) : 0 };
    for (uint32_t i = 0; i < r->columns * r->columns; i++) r->cell[i] = NOBODY;
    for (uint32_t i = 0; i < n; i++) {
        if (!r->reflex[i]) continue;
        Point2 g = in_grid(r, r->point[i]);
        uint32_t *cell = &r->cell[cell_of(g.y, r->columns) * r->columns + cell_of(g.x, r->columns)];
        r->chain[i] = *cell;
        *cell = i;
    }
}

static bool is_reflex(const Ring *r, uint32_t i)
{
    return turn(r->point[r->previous[i]], r->point[i], r->point[r->next[i]]) <= 0;
}

static void enqueue(Ring *r, uint32_t i, uint32_t n)
{
    if (r->queued[i] || r->reflex[i]) return;
    r->queued[i] = true;
    r->queue[(r->head + r->waiting++) % n] = i;
}

/* Convex corners wait in a queue. A cut lets its two neighbours wait again; what was blocked is tried again once nobody waits. If that cuts
 * nothing, the polygon crosses itself or is flat, and a corner is cut off unseen. */
static void cut_ears(Ring *r, uint32_t n, uint32_t (*triangle)[3])
{
    uint32_t left = n, some = 0;       /* some = a corner that is left */
    bool fruitless = false;            /* nothing was cut since all had a try */
    for (uint32_t k = 0; k < n - 2;) {
        uint32_t b = some;
        if (r->waiting > 0) {
            b = r->queue[r->head];
            r->head = (r->head + 1) % n;
            r->waiting--;
            r->queued[b] = false;
            if (r->gone[b] || r->reflex[b] || blocked(r, r->previous[b], b, r->next[b])) continue;
        } else if (!fruitless && r->budget > left) {
            r->budget -= left;
            fruitless = true;
            for (uint32_t i = 0; i < left; i++, some = r->next[some]) enqueue(r, some, n);
            continue;
        }
        uint32_t a = r->previous[b], c = r->next[b];
        triangle[k][0] = a;
        triangle[k][1] = b;
        triangle[k++][2] = c;
        r->next[a] = c;
        r->previous[c] = a;
        r->reflex[b] = false;
        r->gone[b] = true;
        /* A reflex corner may become convex; the other way only where the polygon crosses itself, and then nothing relies on it. */
        if (r->reflex[a]) r->reflex[a] = is_reflex(r, a);
        if (r->reflex[c]) r->reflex[c] = is_reflex(r, c);
        enqueue(r, a, n);
        enqueue(r, c, n);
        left--;
        fruitless = false;
        some = c;
    }
}

bool polygon_triangulate(const float (*position)[3], const uint32_t *corner, uint32_t n, uint32_t (*triangle)[3])
{
    Vec3 normal = newell_normal(position, corner, n);
    if (n == 4) {
        split_quad(position, corner, normal, triangle);
        return true;
    }
    bool convex = true;
    Point2 last = project(position[corner[n - 2]], normal), here = project(position[corner[n - 1]], normal);
    for (uint32_t i = 0; i < n && convex; i++) {
        Point2 next = project(position[corner[i]], normal);
        convex = turn(last, here, next) > 0;
        last = here;
        here = next;
    }
    if (convex || n == 3) {
        for (uint32_t i = 0; i < n - 2; i++) {
            triangle[i][0] = 0;
            triangle[i][1] = i + 1;
            triangle[i][2] = i + 2;
        }
        return true;
    }
    Ring r = { .budget = 1000 * (uint64_t)n, .columns = 1 };
    while (r.columns < 4096 && (uint64_t)(r.columns + 1) * (r.columns + 1) <= n) r.columns++;
    r.point = malloc(n * sizeof *r.point);
    r.reflex = calloc(3 * (size_t)n, sizeof *r.reflex);
    uint32_t *links = malloc((4 * (size_t)n + r.columns * r.columns) * sizeof *links);
    bool ok = r.point && r.reflex && links;
    if (ok) {
        r.previous = links;
        r.next = links + n;
        r.chain = links + 2 * (size_t)n;
        r.queue = links + 3 * (size_t)n;
        r.cell = links + 4 * (size_t)n;
        r.queued = r.reflex + n;
        r.gone = r.reflex + 2 * (size_t)n;
        for (uint32_t i = 0; i < n; i++) {
            r.point[i] = project(position[corner[i]], normal);
            r.previous[i] = i ? i - 1 : n - 1;
            r.next[i] = i + 1 < n ? i + 1 : 0;
        }
        for (uint32_t i = 0; i < n; i++) r.reflex[i] = is_reflex(&r, i);
        build_grid(&r, n);
        cut_ears(&r, n, triangle);
    }
    free(r.point);
    free(r.reflex);
    free(links);
    return ok;
}
