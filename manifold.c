/* The manifold perturbation: L S+ D (S+ D)* S* E moved on the film, while the point of the lamp stays. [Jakob and Marschner 2012: manifold exploration]
 *
 * Between D and the light such a path cannot be joined. The multi-chain perturbation turns the direction at the D next to the light and hopes to meet the lamp
 * again; if that is small, it seldom does. Here the direction is searched for: Newton's method, on the ray that leaves D, passes the specular vertices by
 * the copied modes and ought to arrive at x_0. In T(y|x) stand the step on the film, which is symmetric, and for the D a density that is constant over the
 * area of the lamp, which is |dx_0/dw| per solid angle:
 *
 *     R(y|x) = chi(y) * product of S< * F |cos| at every D * |dw/dx_0| at the last * L_e          (without specular vertices: F G L_e, the join)
 *
 * From y the search has to find the way back to what it finds at x, or there is no such step.
 */
#include "mutate.h"

enum { MOST_SPECULAR = 8, MOST_TRIES = 12 };
/* Scene units. So near the target is there; so near are vertices the same if both were found, or if one is of a path: rays start a little beside their
 * surface (scene.h), so a path that was grown from the light is not quite the one that is found. */
static const double THERE = 1e-10, SAME = 1e-7, ALIKE = 1e-3;

int manifold_diffuse(const Path *x)
{
    int turned, d = 1;
    if (lens_suffix(x, &turned) != 0 || turned == 0) return 0;
    while (x->v[d].mode != MODE_NONE) d++;
    return d - 1 <= MOST_SPECULAR ? d : 0;
}

bool manifold_applies(const Space *space, const Path *x) { (void)space; return manifold_diffuse(x) > 0; }

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

/* At a specular vertex, arriving from the direction 'known'. */
static void scatter(Change *c, const Scene *scene, const Point *at, Vec3 known, Mode mode)
{
    for (int i = 0; i < 2; i++) c->w[i] = bsdf_follow_change(&at->surface, known, mode, neg(c->w[i]), scene_normal_change(scene, at, c->p[i]));
}

double manifold_spread(const Scene *scene, const Path *x)
{
    int d = manifold_diffuse(x);
    Change c = leave(neg(x->v[d - 1].to_lens));
    for (int i = d - 1; i >= 0; i--) {
        const Vertex *v = &x->v[i];
        travel(&c, neg(v->to_lens), length(sub(v[1].point.p, v->point.p)), v->point.surface.ng);
        if (i > 0) scatter(&c, scene, &v->point, v->to_lens, v->mode);
    }
    return 1 / length(cross(c.p[0], c.p[1]));
}

/* A ray from v[d] in direction w: sets v[d-1] .. v[1], specular by the modes of 'like', the direction in which it leaves the last, and where it meets the
 * plane of the target. False if it gets lost. */
typedef struct { Vec3 w, arrival; Change change; } Flight;
static bool fly(const Scene *scene, const Path *like, Vertex *v, int d, Vec3 w, const Point *target, Flight *f)
{
    f->w = w;
    f->change = leave(w);
    for (int i = d - 1; i > 0; i--) {
        if (!scene_trace(scene, &v[i + 1].point, f->w, &v[i].point) || !material_is_specular(v[i].point.surface.material)) return false;
        Vec3 back = sub(v[i + 1].point.p, v[i].point.p);
        double distance = length(back);
        v[i].mode = like->v[i].mode;
        v[i].to_lens = scale(1 / distance, back);
        if (!(distance > 0) || !bsdf_follow(&v[i].point.surface, v[i].to_lens, v[i].mode, &f->w)) return false;
        travel(&f->change, neg(v[i].to_lens), distance, v[i].point.surface.ng);
        scatter(&f->change, scene, &v[i].point, v[i].to_lens, v[i].mode);
    }
    Vec3 from = scene_leave(&v[1].point, f->w), ng = target->surface.ng;
    double distance = dot(sub(target->p, from), ng) / dot(f->w, ng);
    if (!(distance > 0 && distance < INFINITY)) return false;
    f->arrival = along(from, distance, f->w);
    travel(&f->change, f->w, distance, ng);
    return true;
}

/* Sets v[d-1] .. v[0] to the way from v[d] to the target that is found from a first guess w, if it is found, and nothing is in between. */
static bool search(const Scene *scene, const Path *like, Vertex *v, int d, Vec3 w, const Point *target)
{
    Vec3 best = w, step = vec3(0, 0, 0);
    double nearest = INFINITY, part = 1;
    for (int n = 0; n < MOST_TRIES && part > 0.1; n++) {
        Flight f;
        if (fly(scene, like, v, d, w, target, &f)) {
            Vec3 off = sub(target->p, f.arrival);
            double distance = length(off);
            if (distance < THERE) {
                v[0].mode = MODE_NONE;
                return scene_trace(scene, &v[1].point, f.w, &v[0].point) && v[0].point.triangle == target->triangle;
            }
            if (distance < nearest) {
                const Vec3 *p = f.change.p;
                Vec3 area = cross(p[0], p[1]);
                double squared = dot(area, area), a = dot(cross(off, p[1]), area) / squared, b = dot(cross(p[0], off), area) / squared;
                if (!(a * a + b * b < 1)) return false;
                Change start = leave(w);
                nearest = distance;
                best = w;
                step = along(scale(a, start.w[0]), b, start.w[1]);
                part = 2;
            }
        }
        part *= 0.5;                           /* of Newton's step: too far where it got lost, or no nearer */
        if (isinf(nearest)) return false;
        w = normalize(along(best, part, step));
    }
    return false;
}

/* What is found at x_d itself, or there again from y. */
static bool search_at(const Scene *scene, const Path *x, const Path *like, Vertex *v, int d)
{
    v[d] = x->v[d];
    return search(scene, like, v, d, normalize(sub(like->v[d - 1].point.p, x->v[d].point.p)), &like->v[0].point);
}

static bool near(const Vertex *a, const Vertex *b, int d, double distance)
{
    for (int i = 1; i < d; i++)
        if (!(length(sub(a[i].point.p, b[i].point.p)) < distance)) return false;
    return true;
}

Outcome manifold_propose(const Space *space, const Tuning *tuning, const Path *x, Path *y, Rng *rng, Move *move)
{
    const Scene *scene = space->scene;
    Vertex found[MOST_SPECULAR + 2], back[MOST_SPECULAR + 2];
    int d = manifold_diffuse(x);
    Outcome outcome = perturb_walk(space, tuning, x, y, d, rng);
    if (outcome != PROPOSED) return outcome;
    if (material_is_specular(y->v[d].point.surface.material)) return ZERO_SIDE;
    y->v[d].mode = MODE_NONE;
    if (!search(scene, x, y->v, d, normalize(sub(x->v[d - 1].point.p, y->v[d].point.p)), &x->v[0].point)) return ZERO_LOST;
    for (int i = d - 1; i >= 0; i--)
        if (!path_edge(y, i)) return ZERO_LOST;
    outcome = perturb_evaluate(space, y, 0, y->k, -1);
    if (outcome != PROPOSED) return outcome;
    if (!search_at(scene, x, x, found, d) || !near(found, x->v, d, ALIKE) || !search_at(scene, x, y, back, d) || !near(found, back, d, SAME)) return ZERO_NO_WAY;
    *move = (Move){ .joined = -1, .first = 0, .last = x->k - 1, .spread_x = manifold_spread(scene, x), .spread_y = manifold_spread(scene, y) };
    move->R_yx = lens_R(y, 0) * move->spread_y;
    move->R_xy = lens_R(x, 0) * move->spread_x;
    return isfinite(move->R_yx) && isfinite(move->R_xy) ? PROPOSED : ZERO_NO_WAY;     /* all directions lead to one place: a focus */
}
