/* Path space: growth by one vertex, and the cached quantities of a path. See path.h for the symbols. */
#include "specular.h"
#include "cache.h"
#include <string.h>

void path_copy(Path *to, const Path *from)
{
    memcpy(to, from, offsetof(Path, v) + ((size_t)from->k + 1) * sizeof from->v[0]);
}

bool path_edge(Path *p, int i)
{
    Vertex *a = &p->v[i], *b = &p->v[i + 1];
    Vec3 d = sub(b->point.p, a->point.p);
    double squared = dot(d, d), inv = 1 / sqrt(squared);
    a->to_lens = scale(inv, d);
    a->inv_G = squared / fabs(dot(a->to_lens, a->point.surface.ng) * dot(a->to_lens, b->point.surface.ng));
    return a->inv_G > 0 && a->inv_G < INFINITY;    /* false for NaN: coincident points */
}

bool path_grow_to_lens(const Space *space, Path *p, int i, Rng *rng)
{
    Vertex *next = &p->v[i + 1];
    next->mode = MODE_NONE;        /* until a direction is sampled from it */
    if (i < 0) {
        const double u[3] = { rng_double(rng), rng_double(rng), rng_double(rng) };
        scene_sample_light(space->scene, u, &next->point);
        return true;
    }
    Vertex *v = &p->v[i];
    Vec3 w;
    if (i == 0) {
        v->mode = MODE_NONE;
        w = sample_cosine(v->point.surface.ng, rng);
    } else if (!bsdf_sample(&v->point.surface, neg(v[-1].to_lens), rng, &w, &v->mode)) return false;
    return scene_trace(space->scene, &v->point, w, &next->point) && path_edge(p, i);
}

/* Root of the lamp's tree; 0 for the cosine law. */
static uint32_t emission_tree(const Space *space, const Point *lamp)
{
    return space->emission ? emission_root(space->emission, (uint32_t)(lamp->surface.material - space->scene->mesh.material)) : 0;
}

bool path_leave_lamp(const Space *space, Path *p, Rng *rng)
{
    Vertex *lamp = &p->v[0], *next = &p->v[1];
    uint32_t tree = emission_tree(space, &lamp->point);
    if (tree == 0) return path_grow_to_lens(space, p, 0, rng);
    lamp->mode = next->mode = MODE_NONE;
    Vec3 w = emission_sample(space->emission, tree, lamp->point.surface.ng, rng);
    return dot(w, lamp->point.surface.ng) > 0 && scene_trace(space->scene, &lamp->point, w, &next->point) && path_edge(p, 0);
}

double path_emission_ratio(const Space *space, const Point *lamp, Vec3 w)
{
    uint32_t tree = emission_tree(space, lamp);
    return tree == 0 ? 1 : emission_ratio(space->emission, tree, w, dot(w, lamp->surface.ng));
}

bool path_look(const Space *space, Path *p, double x, double y)
{
    const Camera *camera = &space->scene->camera;
    if (space->film) prefetch_line(&space->film[(uint32_t)y * camera->width + (uint32_t)x]);    /* path_finish reads it when the ray is back */
    p->v[p->k - 1].mode = MODE_NONE;
    Vec3 w = camera_direction(camera, &p->v[p->k].point, x, y);
    return scene_trace(space->scene, &p->v[p->k].point, w, &p->v[p->k - 1].point) && path_edge(p, p->k - 1);
}

bool path_grow_to_light(const Space *space, Path *p, int i, Rng *rng)
{
    const Camera *camera = &space->scene->camera;
    Vertex *next = &p->v[i - 1];
    if (i == p->k) return path_look(space, p, rng_double(rng) * camera->width, rng_double(rng) * camera->height);
    next->mode = MODE_NONE;
    if (i == p->k + 1) {
        camera_sample_lens(camera, rng, &next->point);
        return true;
    }
    Vertex *v = &p->v[i];
    Vec3 w;
    return bsdf_sample(&v->point.surface, v->to_lens, rng, &w, &v->mode)
        && scene_trace(space->scene, &v->point, w, &next->point) && path_edge(p, i - 1);
}

bool path_scatter(const Space *space, Path *p, int i)
{
    Vertex *v = &p->v[i];
    if (i > 0 && i < p->k) return bsdf_scatter(&v->point.surface, neg(v[-1].to_lens), v->to_lens, v->mode, &v->s);
    v->mode = MODE_NONE;
    if (i == 0) {
        const Material *m = v->point.surface.material;
        if (!material_emits(m) || dot(v->to_lens, v->point.surface.ng) <= 0) return false;
        p->light_pdf_a = scene_light_pdf_a(space->scene, m);
        v->s = bsdf_emission(m);
        return true;
    }
    double we;
    const Camera *camera = &space->scene->camera;
    if (!camera_project(camera, &v->point, neg(v[-1].to_lens), &p->raster_x, &p->raster_y, &we)) return false;
    p->pixel = (uint32_t)p->raster_y * camera->width + (uint32_t)p->raster_x;
    v->s = (Scatter){ vec3(1, 1, 1), 1 / we, 0, 1, 1, false };
    return true;
}

Reach path_reach(const Path *p)
{
    bool direct = true, joined = false, before = true;   /* 'before': the vertex before could be joined */
    for (int i = 1; i <= p->k; i++) {
        bool now = !path_specular(p, i);
        if (now && i > 1 && i < p->k) direct = false;
        joined |= now && before;
        before = now;
    }
    return direct ? joined ? REACH_DIRECT : REACH_SEEN : joined ? REACH_INDIRECT : REACH_UNJOINED;
}

/* The vertex that is not specular next to the light, where specular ones lie between; 0 if that is none, or the lens, or nobody would look for the lamp. */
static int bent_at(const Space *space, const Path *p, Reach reach)
{
    if (reach_is_direct(reach) || !space_bends(space, reach == REACH_INDIRECT)) return 0;
    int d = 1;
    while (path_specular(p, d)) d++;
    return d > 1 && d < p->k && specular_sought(&p->v[0].point, d) ? d : 0;
}

static bool equal(Vec3 a, Vec3 b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

static SpecularWay way_to(const Scene *scene, Path *p, int d)
{
    const Vec3 at[4] = { p->v[0].point.p, p->v[1].point.p, p->v[d - 1].point.p, p->v[d].point.p };
    bool known = p->known.d == d;
    for (int i = 0; i < 4 && known; i++) known = equal(at[i], p->known.at[i]);
    if (!known) {
        p->known.d = d;
        memcpy(p->known.at, at, sizeof at);
        p->known.way = specular_way(scene, p->v, d);
    }
    return p->known.way;
}

/* Density of bending a walk from v[d], over f of the path from there. */
static double bent(const Scene *scene, Path *p, int d)
{
    const Vertex *v = &p->v[d];
    SpecularWay way = way_to(scene, p, d);
    double inverse = p->light_pdf_a * p->v[0].s.inv_F * v->s.inv_F / (fabs(dot(v[-1].to_lens, v->point.surface.ng)) * way.spread), guessed = 1;
    for (int i = 1; i < d; i++) {
        inverse *= p->v[i].s.inv_S_light / p->v[i].s.q;
        guessed *= specular_guess_q(p->v[i].s.q);
    }
    return inverse * specular_chance(&way, v->s.inv_S_light / v->s.inv_F * fabs(dot(v[-1].to_lens, v->point.surface.ng)) * guessed).nominal;
}

static double traced_value(const Space *space, Path *p, Reach reach)
{
    const Scene *scene = space->scene;
    double from_lens = path_inv_C(p, -1) * path_inv_S_light(p, 1), joined = p->k > 1 ? path_inv_S_lens(p, -1) * path_inv_C(p, 0) : 0, q = 1;
    if (joined > 0) from_lens += joined * scene_light_preference(scene, &p->v[1].point, &p->v[0].point);
    int d = bent_at(space, p, reach);
    for (int i = 2; i <= p->k; i++) {
        from_lens *= path_inv_S_light(p, i);
        if (i == d) from_lens += bent(scene, p, d);
    }
    for (int i = 1; i < p->k; i++) from_lens *= path_traced_survival(&p->v[i].point, p->k - i);
    if (reach_is_direct(reach))
        for (int i = 1; i < p->k; i++) q *= p->v[i].s.q;
    else if (p->k > 1) q = path_first_chance(p->v[p->k - 1].s.q);
    return luminance(p->colour) * q / from_lens;
}

double path_traced_value(const Space *space, Path *p) { return traced_value(space, p, path_reach(p)); }

double path_bidirectional_value(const Space *space, Path *p)
{
    double sum = path_inv_C(p, -1), grown = path_inv_S_lens(p, -1), survival = 1;    /* path_routes(-1, k+1), with roulette */
    int d = bent_at(space, p, path_reach(p));
    for (int e = 0, k = p->k; e < k; e++) {
        double next = e + 1 < k ? path_survival(&p->v[e + 1].point) : 1;
        sum = sum * path_inv_S_light(p, e + 1) * next + grown * path_inv_C(p, e);
        if (e + 1 == d) sum += bent(space->scene, p, d);
        grown *= path_inv_S_lens(p, e) * survival;
        if (e == 0) grown *= path_emission_ratio(space, &p->v[0].point, p->v[0].to_lens);
        survival = next;
    }
    return luminance(p->colour) / sum * path_first_chance(p->v[p->k - 1].s.q);
}

void path_finish(const Space *space, Path *p)
{
    p->colour = p->v[0].s.colour;
    for (int i = 1; i < p->k; i++) p->colour = mul(p->colour, p->v[i].s.colour);
    Reach reach = path_reach(p);
    bool in = p->k <= space->max_depth && (space->direct == DIRECT_INCLUDED || reach_is_direct(reach) == (space->direct == DIRECT_ONLY));
    p->share = !in ? 0 : 1;
    p->value = 0;
    if (in && space->part != WHOLE) {
        p->value = space->bidirectional && !reach_is_direct(reach) ? path_bidirectional_value(space, p) : traced_value(space, p, reach);
        p->share = space_share(space, p->pixel, p->value, reach);
    }
    p->chi = p->share * luminance(p->colour) * (space->film ? (double)space->film[p->pixel].weight : 1);
}

bool path_evaluate(const Space *space, Path *p)
{
    for (int i = 0; i < p->k; i++)
        if (!path_edge(p, i)) return false;
    for (int i = 0; i <= p->k; i++)
        if (!path_scatter(space, p, i)) return false;
    path_finish(space, p);
    return true;
}
