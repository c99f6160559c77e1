/* The search for a way through specular vertices, and how such a way spreads. See specular.h. */
#include "specular.h"

enum { MOST_TRIES = 12 };
static const double THERE = 1e-10,             /* scene unit: so near the target is there */
    LITTLE = 2, FLAT = 4, CURVED = 3000;       /* how far a search finds: radians that normals may turn a way by, areas of triangles that are flat or not */

/* How a ray changes as its direction at D does, towards either of two perpendicular directions: in place, and in direction. */
typedef struct { Vec3 p[2], w[2]; } Change;

static Change leave(Vec3 w)
{
    Change c = { { { 0, 0, 0 }, { 0, 0, 0 } }, { { 0, 0, 0 }, { 0, 0, 0 } } };
    frame(w, &c.w[0], &c.w[1]);
    return c;
}

/* Along w by a distance, to a plane. */
static void travel(Change *c, Vec3 w, double distance, Vec3 ng)
{
    for (int i = 0; i < 2; i++) {
        Vec3 p = along(c->p[i], distance, c->w[i]);
        c->p[i] = along(p, -dot(p, ng) / dot(w, ng), w);
    }
}

/* At a vertex that is passed, arriving from the direction 'known'. */
static void scatter(Change *c, const Scene *scene, const Point *at, Vec3 known, const Passage *passage)
{
    for (int i = 0; i < 2; i++) c->w[i] = bsdf_pass_change(&at->surface, known, passage, neg(c->w[i]), scene_normal_change(scene, at, c->p[i]));
}

/* The solid angle at D in which a specular vertex stays as it is: on its triangle where that is flat, else as long as the way is turned by little only
 * because the normal is another. */
static double unchanged(const Scene *scene, const Vertex *v, const Change *c)
{
    double turned = 0;
    const Passage passage = { .mode = v->mode };
    for (int i = 0; i < 2; i++) {
        Vec3 d = bsdf_pass_change(&v->point.surface, v->to_lens, &passage, vec3(0, 0, 0), scene_normal_change(scene, &v->point, c->p[i]));
        turned += dot(d, d);
    }
    double triangle = scene_triangle_area(scene, v->point.triangle) / length(cross(c->p[0], c->p[1]));
    if (turned > 0) return smaller(PI * LITTLE * LITTLE * 2 / turned, CURVED * triangle);
    return FLAT * triangle;
}

/* A ray from v[d] in direction w: sets v[d-1] .. v[1], the direction in which it leaves the last, and where it meets the plane of the target. False if
 * it gets lost. */
typedef struct { Vec3 w, arrival; Change change; } Flight;
static bool fly(const Scene *scene, const Passage passage[], Vertex *v, int d, Vec3 w, const Point *target, Flight *f)
{
    f->w = w;
    f->change = leave(w);
    for (int i = d - 1; i > 0; i--) {
        if (!scene_trace(scene, &v[i + 1].point, f->w, &v[i].point)) return false;
        Vec3 back = sub(v[i + 1].point.p, v[i].point.p);
        double distance = length(back);
        v[i].mode = passage[i].mode;
        v[i].to_lens = scale(1 / distance, back);
        if (!(distance > 0) || !bsdf_pass(&v[i].point.surface, v[i].to_lens, &passage[i], &f->w)) return false;
        travel(&f->change, neg(v[i].to_lens), distance, v[i].point.surface.ng);
        scatter(&f->change, scene, &v[i].point, v[i].to_lens, &passage[i]);
    }
    Vec3 from = v[1].point.p, ng = target->surface.ng;
    double distance = dot(sub(target->p, from), ng) / dot(f->w, ng);
    if (!(distance > 0 && distance < INFINITY)) return false;
    f->arrival = along(from, distance, f->w);
    travel(&f->change, f->w, distance, ng);
    return true;
}

/* Newton's step from a flight that met the plane of the target so far off it: in the directions of leave(). False if it is too large to mean anything. */
static bool newton(const Flight *f, Vec3 w, Vec3 off, Vec3 *step)
{
    const Vec3 *p = f->change.p;
    Vec3 area = cross(p[0], p[1]);
    double squared = dot(area, area), a = dot(cross(off, p[1]), area) / squared, b = dot(cross(p[0], off), area) / squared;
    Change start = leave(w);
    *step = along(scale(a, start.w[0]), b, start.w[1]);
    return a * a + b * b < 1;
}

/* Whether the search from the straight line to the lamp is likely to end at this way: its first step leads most of the way there. */
static bool found_straight(const Scene *scene, const Passage passage[], const Vertex *v, int d)
{
    Vertex near[MOST_SPECULAR + 2];
    Flight f;
    Vec3 step, there = neg(v[d - 1].to_lens), w = normalize(sub(v[0].point.p, v[d].point.p)), off = sub(there, w);
    near[d].point = v[d].point;
    if (!fly(scene, passage, near, d, w, &v[0].point, &f) || !newton(&f, w, sub(v[0].point.p, f.arrival), &step)) return false;
    Vec3 left = sub(there, normalize(add(w, step)));
    return dot(left, left) < 0.25 * dot(off, off) || dot(off, off) < 1e-12;
}

/* How the way v[d] .. v[0] changes as its direction at v[d] does, at v[0]; 'basin' as in SpecularWay, NULL if nobody asks. */
static Change arrival(const Scene *scene, const Passage passage[], const Vertex *v, int d, double *basin)
{
    Change c = leave(neg(v[d - 1].to_lens));
    for (int i = d - 1; ; i--) {
        const Point *at = &v[i].point;
        travel(&c, neg(v[i].to_lens), length(sub(v[i + 1].point.p, at->p)), at->surface.ng);
        if (i == 0) return c;
        if (basin) *basin = smaller(*basin, unchanged(scene, &v[i], &c));
        scatter(&c, scene, at, v[i].to_lens, &passage[i]);
    }
}

static double spread(const Change *c) { return 1 / length(cross(c->p[0], c->p[1])); }

double specular_spread(const Scene *scene, const Passage passage[], const Vertex *v, int d)
{
    Change c = arrival(scene, passage, v, d, NULL);
    return spread(&c);
}

SpecularWay specular_way(const Scene *scene, const Vertex *v, int d)
{
    SpecularWay way = { .basin = 2 * PI, .through = true };
    Passage passage[MOST_SPECULAR + 2];
    for (int i = 1; i < d; i++) {
        passage[i] = (Passage){ .mode = v[i].mode };
        way.through = way.through && v[i].mode == MODE_REFRACT;
    }
    Change c = arrival(scene, passage, v, d, &way.basin);
    way.spread = spread(&c);
    way.through = way.through && found_straight(scene, passage, v, d);
    return way;
}

bool specular_search(const Scene *scene, const Passage passage[], Vertex *v, int d, Vec3 w, const Point *target)
{
    Vec3 best = w, step = vec3(0, 0, 0);
    double nearest = INFINITY, part = 1;
    for (int n = 0; n < MOST_TRIES && part > 0.1; n++) {
        Flight f;
        if (fly(scene, passage, v, d, w, target, &f)) {
            Vec3 off = sub(target->p, f.arrival);
            double distance = length(off);
            if (distance < THERE) {
                v[0].mode = MODE_NONE;
                if (target->triangle == BVH_NONE) {        /* of the lens */
                    v[0].point = *target;
                    return scene_visible(scene, &v[1].point, target);
                }
                return scene_trace(scene, &v[1].point, f.w, &v[0].point) && v[0].point.triangle == target->triangle;
            }
            if (distance < nearest) {
                if (!newton(&f, w, off, &step)) return false;
                nearest = distance;
                best = w;
                part = 2;
            }
        }
        part *= 0.5;                           /* of Newton's step: too far where it got lost, or no nearer */
        if (isinf(nearest)) return false;
        w = normalize(along(best, part, step));
    }
    return false;
}

bool specular_near(const Vertex *a, const Vertex *b, int d, double distance)
{
    for (int i = 1; i < d; i++)
        if (!(length(sub(a[i].point.p, b[i].point.p)) < distance)) return false;
    return true;
}
