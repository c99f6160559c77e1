/* Tests the ray queries against brute force in double, and shoots at seams. Each kind of check is also given a faulty query (naive_*), the
 * mistakes that ray tracers really make, and must catch it. */
#include "../bvh.h"
#include "../rng.h"
#include "check.h"
#include <float.h>
#include <stdlib.h>
#include <string.h>

typedef struct { float (*position)[3]; uint32_t (*triangle)[3]; uint32_t n_positions, n; Bvh *bvh; } Soup;
typedef bool (*Query)(const Soup *, const Ray *, Hit *);

static const double TOLERANCE = 1e-6;  /* of a ray's place beside an edge, relative to the distance: some sixteen roundings to float */

/* ---- meshes ---- */

static Soup soup_new(uint32_t n_positions, uint32_t n)
{
    Soup s = { calloc(n_positions + 1, sizeof *s.position), calloc(n + 1, sizeof *s.triangle), n_positions, n, NULL };
    if (!s.position || !s.triangle) exit(2);
    return s;
}

/* n triangles of three corners each of their own */
static Soup soup_loose(uint32_t n)
{
    Soup s = soup_new(3 * n, n);
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t k = 0; k < 3; k++) s.triangle[i][k] = 3 * i + k;
    return s;
}

static void soup_build(Soup *s, BvhEffort effort)
{
    bvh_free(s->bvh);
    s->bvh = bvh_new((const float (*)[3])s->position, (const uint32_t (*)[3])s->triangle, s->n, effort);
    if (!CHECK(s->bvh != NULL)) exit(2);
}

static void soup_free(Soup *s)
{
    bvh_free(s->bvh);
    free(s->position);
    free(s->triangle);
}

static Vec3 corner(const Soup *s, uint32_t triangle, int k) { return from_float(s->position[s->triangle[triangle][k]]); }
static double spread(Rng *rng) { return 2 * rng_double(rng) - 1; }
static Vec3 in_cube(Rng *rng) { double x = spread(rng), y = spread(rng), z = spread(rng); return vec3(x, y, z); }

static void set(float p[3], Vec3 v) { p[0] = (float)v.x; p[1] = (float)v.y; p[2] = (float)v.z; }

static void set_triangle(Soup *s, uint32_t i, Vec3 a, Vec3 b, Vec3 c)
{
    set(s->position[3 * i], a); set(s->position[3 * i + 1], b); set(s->position[3 * i + 2], c);
}

typedef enum { RANDOM, NEEDLE, COPLANAR, AXIS_ALIGNED, POINTS, LINES, NESTED, KINDS } Kind;

static Soup soup_of(Kind kind, uint32_t n, Rng *rng)
{
    Soup s = soup_loose(n);
    for (uint32_t i = 0; i < n; i++) {
        Vec3 a = scale(0.9, in_cube(rng)), u = scale(0.1, in_cube(rng)), v = scale(0.1, in_cube(rng));
        if (kind == NEEDLE) { u = scale(8, u); v = along(u, 1e-4, v); }
        if (kind == COPLANAR) a.z = u.z = v.z = 0.25;
        if (kind == COPLANAR) u.z = v.z = 0;
        if (kind == AXIS_ALIGNED) {
            double eighth[3] = { floor(8 * a.x) / 8, floor(8 * a.y) / 8, floor(8 * a.z) / 8 }, side[2][3] = { { 0 }, { 0 } };
            uint32_t axis = rng_index(rng, 3);
            side[0][(axis + 1) % 3] = side[1][(axis + 2) % 3] = 0.125 * (1 + rng_index(rng, 3));
            a = vec3(eighth[0], eighth[1], eighth[2]);
            u = vec3(side[0][0], side[0][1], side[0][2]);
            v = vec3(side[1][0], side[1][1], side[1][2]);
        }
        if (kind == POINTS) u = v = vec3(0, 0, 0);
        if (kind == LINES) v = scale(2, u);
        if (kind == NESTED) { double size = pow(0.95, i); a = scale(size, a); u = scale(size, u); v = scale(size, v); }
        set_triangle(&s, i, a, add(a, u), add(a, v));
    }
    return s;
}

/* A closed star-shaped surface about a centre: rows * 2 rows quads, vertices shared by index. */
static Soup bumpy_sphere(uint32_t rows, double radius, Vec3 centre)
{
    uint32_t columns = 2 * rows;
    Soup s = soup_new((rows - 1) * columns + 2, 2 * columns * (rows - 1));
    uint32_t north = s.n_positions - 2, south = north + 1, n = 0;
    for (uint32_t i = 0; i + 1 < rows; i++)
        for (uint32_t j = 0; j < columns; j++) {
            double theta = PI * (i + 1) / rows, phi = 2 * PI * j / columns;
            double r = radius * (1 + 0.1 * sin(5 * theta) * cos(7 * phi) + 0.02 * cos(31 * phi));
            set(s.position[i * columns + j], along(centre, r, vec3(sin(theta) * cos(phi), cos(theta), sin(theta) * sin(phi))));
        }
    set(s.position[north], along(centre, radius, vec3(0, 1, 0)));
    set(s.position[south], along(centre, radius, vec3(0, -1, 0)));
    for (uint32_t i = 0; i < rows; i++)
        for (uint32_t j = 0; j < columns; j++) {
            uint32_t k = (j + 1) % columns, up = (i - 1) * columns, down = i * columns;
            uint32_t quad[4] = { i ? up + j : north, i ? up + k : north, i + 1 < rows ? down + k : south, i + 1 < rows ? down + j : south };
            if (i) { s.triangle[n][0] = quad[0]; s.triangle[n][1] = quad[1]; s.triangle[n++][2] = quad[2]; }
            if (i + 1 < rows) { s.triangle[n][0] = quad[0]; s.triangle[n][1] = quad[2]; s.triangle[n++][2] = quad[3]; }
        }
    return s;
}

/* ---- queries: the real one and the faulty ones ---- */

static bool tree(const Soup *s, const Ray *ray, Hit *hit) { return bvh_closest(s->bvh, ray, hit); }

/* Fault: Moeller and Trumbore's test in float with an absolute bound on the determinant and inside bounds that leave gaps. */
static bool naive_triangle(const Soup *s, const Ray *ray, Hit *hit, uint32_t i)
{
    float o[3], d[3], a[3], e[2][3], p[3], q[3], r[3];
    set(o, ray->origin);
    set(d, ray->direction);
    for (int k = 0; k < 3; k++) {
        a[k] = s->position[s->triangle[i][0]][k];
        e[0][k] = s->position[s->triangle[i][1]][k] - a[k];
        e[1][k] = s->position[s->triangle[i][2]][k] - a[k];
        r[k] = o[k] - a[k];
    }
    for (int k = 0; k < 3; k++) {
        int l = (k + 1) % 3, m = (k + 2) % 3;
        p[k] = d[l] * e[1][m] - d[m] * e[1][l];
        q[k] = r[l] * e[0][m] - r[m] * e[0][l];
    }
    float det = e[0][0] * p[0] + e[0][1] * p[1] + e[0][2] * p[2];
    if (fabsf(det) < 1e-8f) return false;
    float u = (r[0] * p[0] + r[1] * p[1] + r[2] * p[2]) / det, v = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / det;
    float t = (e[1][0] * q[0] + e[1][1] * q[1] + e[1][2] * q[2]) / det;
    if (!(u > 1e-6f && v > 1e-6f && u + v < 1 - 1e-6f && t > 0 && (double)t < ray->t_max)) return false;
    if (i == ray->skip[0] || i == ray->skip[1]) return false;
    *hit = (Hit){ (double)t, (double)u, (double)v, i };
    return true;
}

static bool naive_brute(const Soup *s, const Ray *ray, Hit *hit)
{
    Ray r = *ray;
    bool any = false;
    for (uint32_t i = 0; i < s->n; i++)
        if (naive_triangle(s, &r, hit, i)) { r.t_max = hit->t; any = true; }
    return any;
}

/* Fault: boxes with strict bounds, which a flat box never meets and a zero component turns to NaN. */
static bool naive_boxes(const Soup *s, const Ray *ray, Hit *hit)
{
    double o[3] = { ray->origin.x, ray->origin.y, ray->origin.z }, d[3] = { ray->direction.x, ray->direction.y, ray->direction.z };
    bool any = false;
    Ray r = *ray;
    for (uint32_t i = 0; i < s->n; i++) {
        double t0 = 0, t1 = ray->t_max;
        for (int a = 0; a < 3; a++) {
            double low = INFINITY, high = -INFINITY;
            for (int k = 0; k < 3; k++) {
                low = fmin(low, (double)s->position[s->triangle[i][k]][a]);
                high = fmax(high, (double)s->position[s->triangle[i][k]][a]);
            }
            double near = (low - o[a]) / d[a], far = (high - o[a]) / d[a];
            t0 = fmax(t0, fmin(near, far));
            t1 = fmin(t1, fmax(near, far));
        }
        Hit h;
        if (t0 < t1 && naive_triangle(s, &r, &h, i)) { r.t_max = h.t; *hit = h; any = true; }
    }
    return any;
}

/* Fault: forgets t_max and skip. */
static bool naive_endless(const Soup *s, const Ray *ray, Hit *hit)
{
    Ray r = *ray;
    r.t_max = INFINITY;
    r.skip[0] = r.skip[1] = BVH_NONE;
    return bvh_closest(s->bvh, &r, hit);
}

/* ---- comparison with brute force ---- */

/* How the ray's line passes a triangle, in lengths (not in t). */
typedef struct {
    double inside;                     /* distance from the nearest edge if inside, minus the distance if outside; 0 if seen edge-on */
    double depth, low, high;           /* where it meets the plane; the span of the corners; along the ray */
    double slack;                      /* bound of what rounding may do to 'inside' */
    double error;                      /* bound of what rounding may do to the depth, and to the point that u and v tell: large on needles,
                                          where little beside the ray is much along the needle, but never far beyond the corners */
} Pass;

static Pass pass_triangle(const Soup *s, uint32_t i, Vec3 origin, Vec3 w)
{
    Vec3 a, b, p[3];
    frame(w, &a, &b);
    Pass pass = { INFINITY, 0, INFINITY, -INFINITY, 0, 0 };
    double longest = 0;
    double x[3], y[3], z[3], distance = 0;
    for (int k = 0; k < 3; k++) {
        p[k] = sub(corner(s, i, k), origin);
        x[k] = dot(p[k], a); y[k] = dot(p[k], b); z[k] = dot(p[k], w);
        pass.low = fmin(pass.low, z[k]);
        pass.high = fmax(pass.high, z[k]);
        distance = fmax(distance, length(p[k]));
    }
    pass.slack = TOLERANCE * fmin(distance, 8);
    double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]), to_segment = INFINITY;
    double weight[3];
    for (int k = 0; k < 3; k++) {
        int l = (k + 1) % 3;
        double ex = x[l] - x[k], ey = y[l] - y[k], e2 = ex * ex + ey * ey;
        longest = fmax(longest, length(sub(p[l], p[k])));
        double side = (x[k] * y[l] - y[k] * x[l]) * (area < 0 ? -1 : 1);
        weight[k] = side / fabs(area);
        pass.inside = fmin(pass.inside, e2 > 0 ? side / sqrt(e2) : 0);
        double f = e2 > 0 ? fmin(fmax(-(x[k] * ex + y[k] * ey) / e2, 0), 1) : 0;
        to_segment = fmin(to_segment, hypot(x[k] + f * ex, y[k] + f * ey));
    }
    if (pass.inside <= 0) pass.inside = -to_segment;
    pass.error = 2 * longest + 4 * pass.slack;
    if (area == 0) { pass.inside = -to_segment; return pass; }
    pass.depth = weight[1] * z[0] + weight[2] * z[1] + weight[0] * z[2];
    double height = fabs(area) / longest;
    pass.error = fmin(pass.error, 4 * pass.slack * (1 + longest / height));
    return pass;
}

/* Whether an answer is one that rounding can explain: the triangle found is passed within the tolerance, at that t and at that u, v;
 * none is passed for sure in front of it. */
static bool plausible(const Soup *s, const Ray *ray, bool found, const Hit *hit)
{
    double speed = length(ray->direction), t_max = ray->t_max * speed, nearest = t_max;
    Vec3 w = scale(1 / speed, ray->direction);
    if (found) {
        if (!isfinite(hit->t) || !isfinite(hit->u) || !isfinite(hit->v)) return false;
        if (hit->triangle >= s->n || hit->triangle == ray->skip[0] || hit->triangle == ray->skip[1]) return false;
        Pass pass = pass_triangle(s, hit->triangle, ray->origin, w);
        double t = hit->t * speed;
        if (pass.inside < -pass.slack || t < pass.low - pass.error || t > pass.high + pass.error || t > t_max + pass.error) return false;
        if (pass.inside > pass.slack && fabs(t - pass.depth) > pass.error) return false;
        Vec3 a = corner(s, hit->triangle, 0), b = corner(s, hit->triangle, 1), c = corner(s, hit->triangle, 2);
        Vec3 p = sub(along(along(a, hit->u, sub(b, a)), hit->v, sub(c, a)), ray->origin);
        if (length(sub(p, scale(t, w))) > 2 * pass.error) return false;
        nearest = t - pass.error;
    }
    for (uint32_t i = 0; i < s->n; i++) {
        if (i == ray->skip[0] || i == ray->skip[1]) continue;
        Pass pass = pass_triangle(s, i, ray->origin, w);
        if (pass.inside > pass.slack && pass.depth > pass.error && pass.depth < nearest - pass.error) return false;
    }
    return true;
}

/* Rays of all kinds: from near and far, at corners, edges and anywhere, along axes, with length from tiny to huge, with an end or without. */
static Ray some_ray(const Soup *s, Rng *rng)
{
    Ray ray = { in_cube(rng), in_cube(rng), INFINITY, { BVH_NONE, BVH_NONE } };
    uint32_t choice = rng_index(rng, 8);
    if (s->n && choice < 4) {
        uint32_t i = rng_index(rng, s->n);
        double u = choice == 1 ? 0 : rng_double(rng), v = choice <= 1 ? rng_double(rng) * (1 - u) : choice == 2 ? 1 - u : 0;
        if (choice == 3) u = v = 0;
        Vec3 a = corner(s, i, 0), target = along(along(a, u, sub(corner(s, i, 1), a)), v, sub(corner(s, i, 2), a));
        if (rng_index(rng, 4) == 0) ray.origin = scale(pow(10, 9 * rng_double(rng)), ray.origin);
        ray.direction = sub(target, ray.origin);
    } else if (choice < 7) {
        /* zero components of either sign, often in the plane of flat boxes */
        double o[3] = { ray.origin.x, ray.origin.y, ray.origin.z }, d[3] = { 0, -0.0, 0 };
        for (int a = 0; a < 3; a++) if (rng_index(rng, 2)) o[a] = floor(8 * o[a]) / 8;
        uint32_t axis = rng_index(rng, 3);
        d[axis] = rng_index(rng, 2) ? 1 : -1;
        if (choice == 6) d[(axis + 1) % 3] = spread(rng);
        ray.origin = vec3(o[0], o[1], o[2]);
        ray.direction = vec3(d[0], d[1], d[2]);
    }
    if (rng_index(rng, 2)) ray.t_max = 1.5 * rng_double(rng);
    double factor = rng_index(rng, 2) ? 1 : pow(10, 12 * spread(rng));
    ray.direction = scale(factor, ray.direction);
    ray.t_max /= factor;
    return ray;
}

/* How many of n rays get an answer that rounding cannot explain. Each ray is asked again without what it met first, and then second. */
static uint32_t wrong_answers(const Soup *s, Query query, uint32_t n, uint64_t seed)
{
    Rng rng = rng_new(seed, 0);
    uint32_t wrong = 0;
    for (uint32_t k = 0; k < n; k++) {
        Ray ray = some_ray(s, &rng);
        for (int again = 0; again < 3; again++) {
            Hit hit = { 0 };
            bool found = query(s, &ray, &hit);
            wrong += !plausible(s, &ray, found, &hit) || (query == tree && bvh_any(s->bvh, &ray) != found);
            if (!found) break;
            if (again < 2) ray.skip[again] = hit.triangle;
        }
    }
    return wrong;
}

static void test_soups(void)
{
    static const char *const name[KINDS] = { "random", "needle", "coplanar", "axis-aligned", "points", "lines", "nested" };
    Rng rng = rng_new(1, 1);
    uint32_t endless = 0, naive = 0, boxes = 0;
    for (int kind = 0; kind < KINDS; kind++)
        for (uint32_t n = 0; n < 500; n = 3 * n + 1)
            for (int effort = 0; effort < 2; effort++) {
                Soup s = soup_of((Kind)kind, n, &rng);
                soup_build(&s, effort ? BVH_BEST : BVH_FAST);
                uint32_t wrong = wrong_answers(&s, tree, 500, n);
                if (!CHECK(wrong == 0)) printf("    %u wrong of 500: %s soup of %u, effort %d\n", wrong, name[kind], n, effort);
                endless += wrong_answers(&s, naive_endless, 50, n);
                naive += wrong_answers(&s, naive_brute, 50, n);
                if (kind == AXIS_ALIGNED) boxes += wrong_answers(&s, naive_boxes, 50, n);
                soup_free(&s);
            }
    CHECK(endless > 10);
    CHECK(naive > 10);
    CHECK(boxes > 10);
}

/* ---- watertightness ---- */

/* How many rays from inside a bumpy sphere get out: at each corner, at points of each edge, anywhere; and the other way round, whether a
 * ray from far outside to the centre slips in. */
static uint32_t escapes(const Soup *s, Query query, double radius, Vec3 centre, uint32_t n, uint64_t seed)
{
    Rng rng = rng_new(seed, 0);
    uint32_t out = 0;
    for (uint32_t k = 0; k < n; k++) {
        uint32_t i = k % s->n, c = rng_index(&rng, 3);
        Vec3 a = corner(s, i, (int)c), b = corner(s, i, (int)(c + 1) % 3);
        double f = (double)(rng_index(&rng, 5)) / 4;
        if (k % 3 == 0) f = rng_double(&rng);
        Vec3 from = k % 2 ? centre : along(centre, 0.4 * radius, in_cube(&rng)), to = k % 5 ? along(a, f, sub(b, a)) : along(centre, radius, in_cube(&rng));
        Ray ray = { from, sub(to, from), INFINITY, { BVH_NONE, BVH_NONE } };
        Hit hit;
        out += !query(s, &ray, &hit) || (query == tree && !bvh_any(s->bvh, &ray));
        if (k % 5 == 0) continue;
        ray.origin = along(to, 1e3 * rng_double(&rng), ray.direction);
        ray.direction = sub(centre, ray.origin);
        ray.t_max = 1;
        out += !query(s, &ray, &hit) || (query == tree && !bvh_any(s->bvh, &ray));
    }
    return out;
}

static void test_watertight(void)
{
    static const struct { double radius; Vec3 centre; } place[] = {
        { 0.8, { 0, 0, 0 } }, { 0.1, { 0.5, -0.7, 0.6 } }, { 1e-4, { 0.7, -0.6, 0.8 } }, { 1e-4, { 0, 0, 0 } }, { 1e-7, { 0, 0, 0 } } };
    for (int k = 0; k < 5; k++)
        for (int effort = 0; effort < 2; effort++) {
            Soup s = bumpy_sphere(40, place[k].radius, place[k].centre);
            soup_build(&s, effort ? BVH_BEST : BVH_FAST);
            CHECK(escapes(&s, tree, place[k].radius, place[k].centre, 30000, 3) == 0);
            soup_free(&s);
            s = bumpy_sphere(12, place[k].radius, place[k].centre);
            soup_build(&s, effort ? BVH_BEST : BVH_FAST);
            CHECK(escapes(&s, tree, place[k].radius, place[k].centre, 30000, 4) == 0);
            CHECK(wrong_answers(&s, tree, 300, 5) == 0);
            if (!effort) CHECK(escapes(&s, naive_brute, place[k].radius, place[k].centre, 1000, 3) > 0);
            soup_free(&s);
        }
}

/* ---- shapes that trap builders ---- */

static void test_ground_plane(void)
{
    Rng rng = rng_new(5, 1);
    Soup s = soup_loose(3002);
    set_triangle(&s, 0, vec3(-1, -0.5, -1), vec3(1, -0.5, -1), vec3(1, -0.5, 1));
    set_triangle(&s, 1, vec3(-1, -0.5, -1), vec3(1, -0.5, 1), vec3(-1, -0.5, 1));
    for (uint32_t i = 2; i < s.n; i++) {
        Vec3 a = scale(0.95, in_cube(&rng)), u = scale(0.01, in_cube(&rng)), v = scale(0.01, in_cube(&rng));
        a.y = -0.5 + 0.01 * rng_double(&rng);
        set_triangle(&s, i, a, add(a, u), add(a, v));
    }
    for (int effort = 0; effort < 2; effort++) {
        soup_build(&s, effort ? BVH_BEST : BVH_FAST);
        CHECK(wrong_answers(&s, tree, 500, 6) == 0);
        CHECK(bvh_bytes(s.bvh) < 130u * s.n);
    }
    soup_free(&s);
}

static void test_coincident(void)
{
    Soup s = soup_loose(5000);
    for (uint32_t i = 0; i < s.n; i++) set_triangle(&s, i, vec3(-0.5, -0.5, 0.1), vec3(0.5, -0.5, 0.2), vec3(0, 0.5, 0.3));
    for (int effort = 0; effort < 2; effort++) {
        soup_build(&s, effort ? BVH_BEST : BVH_FAST);
        CHECK(wrong_answers(&s, tree, 300, 7) == 0);
        CHECK(bvh_bytes(s.bvh) < 130u * s.n);
    }
    soup_free(&s);
}

/* Any finite input builds, and no ray loops or crashes; what is hit at such sizes is not specified. */
static void test_extremes(void)
{
    Rng rng = rng_new(8, 1);
    Soup s = soup_of(RANDOM, 300, &rng);
    static const float size[] = { FLT_MAX, 1e30f, 1e-30f, FLT_MIN, 1e-44f };
    for (int k = 0; k < 5; k++)
        for (int effort = 0; effort < 2; effort++) {
            for (uint32_t i = 0; i < s.n_positions; i++)
                for (int a = 0; a < 3; a++) s.position[i][a] = (float)spread(&rng) * size[k];
            soup_build(&s, effort ? BVH_BEST : BVH_FAST);
            for (int i = 0; i < 200; i++) {
                Ray ray = { scale((double)size[k], in_cube(&rng)), in_cube(&rng), INFINITY, { BVH_NONE, BVH_NONE } };
                Hit hit;
                CHECK(bvh_any(s.bvh, &ray) == bvh_closest(s.bvh, &ray, &hit));
            }
        }
    Ray odd[] = { { { 0, 0, 0 }, { 0, 0, 0 }, 1, { 0, 0 } }, { { NAN, 0, 0 }, { 1, 0, 0 }, 1, { 0, 0 } }, { { 0, 0, 0 }, { 0, NAN, 1 }, 1, { 0, 0 } },
                  { { 0, 0, 0 }, { 1, 0, 0 }, NAN, { 0, 0 } }, { { 0, 0, 0 }, { 1, 0, 0 }, 0, { 0, 0 } }, { { 0, 0, 0 }, { 1, 0, 0 }, -1, { 0, 0 } } };
    for (int i = 0; i < 6; i++) {
        Hit hit;
        CHECK(!bvh_closest(s.bvh, &odd[i], &hit));
        CHECK(!bvh_any(s.bvh, &odd[i]));
    }
    soup_free(&s);
}

int main(void)
{
    test_soups();
    test_watertight();
    test_ground_plane();
    test_coincident();
    test_extremes();
    return check_report();
}
