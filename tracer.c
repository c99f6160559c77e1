/* Path tracing. [Veach ch. 9] See tracer.h.
 *
 * At glass a walk draws one of two ways, for indirect light. For direct light it goes both ways, so that a lamp that is seen by one of them, however
 * faintly, is seen by every sample: what the rarer way brings would else be a few samples of great value. At the first glass so does indirect light,
 * the rarer way by roulette. */
#include "tracer.h"
#include "bend.h"
#include <string.h>

/* Light that one light sample sends over the surface towards 'known', times throughput still to come, with its weight against the
 * chance that scattering finds the same emitter point. */
static Rgb sampled_light(const Space *space, const Point *at, Vec3 known, const double u[3])
{
    Point light;
    Scatter s;
    double preference = scene_pick_light(space->scene, at, known, u, &light);
    if (!(preference > 0)) return vec3(0, 0, 0);
    Vec3 d = sub(light.p, at->p);
    double squared = dot(d, d);
    Vec3 w = scale(1 / sqrt(squared), d);
    double cos_light = -dot(w, light.surface.ng), cos_here = fabs(dot(w, at->surface.ng));
    if (!(squared > 0) || cos_light <= 0 || !bsdf_scatter(&at->surface, w, known, MODE_NONE, &s)) return vec3(0, 0, 0);
    const Material *m = light.surface.material;
    double pdf_a = preference * scene_light_pdf_a(space->scene, m), G = cos_light * cos_here / squared;
    double scattering_pdf_a = bsdf_pdf_pw(&at->surface, known, w) * G;
    if (!scene_visible(space->scene, at, &light)) return vec3(0, 0, 0);
    return scale(G / (s.inv_F * (pdf_a + scattering_pdf_a)), mul(m->ke, s.colour));
}

/* What a path tracer has found so far, and for whom. */
typedef struct {
    const Space *space;
    uint32_t pixel;
    const Numbers *numbers;
    Rng *rng;
    Path *trail;                   /* vertex j from the lens is trail->v[MAX_EDGES - j] */
    int branches;                  /* that may still split off */
    Rgb sum;
    void (*visit)(void *context, const Candidate *);
    void *context;
} Found;

/* Where a walk from the lens stands: it leaves its last vertex, which it met from the direction 'known', in direction w. */
typedef struct {
    Vec3 known, w;
    Mode mode;
    bool split;                    /* it goes both ways here, this is one of them */
    bool branch;                   /* it has split off, and is for direct light alone */
    int edges, diffuse;            /* so far; non-specular vertices */
    bool joined;                   /* an edge so far could be joined */
    Rgb throughput;
    double q;                      /* product of the modes' chances; for direct light it counts in the value, not in the density */
    double first, shared;          /* path_first_chance of its first vertex; so much indirect light counts */
    double chance;                 /* so much direct light counts: like q, but for roulette, and glass where the walk did not split */
} Walk;

enum { BRANCHES = 16 };            /* of one sample */
static const double BRANCH_LEAST = 1.0 / 1024, LEAF_LEAST = 1.0 / 4;   /* below such a chance it is roulette whether to follow a branch, to sample light */

static Vertex *vertex(const Found *f, int edges) { return &f->trail->v[MAX_EDGES - edges]; }

static void add_found(Found *f, Rgb rgb, double value, Reach reach, int n_light, int n_lens)
{
    double share = space_share(f->space, f->pixel, value, reach);
    f->sum = along(f->sum, share, rgb);
    if (!f->visit) return;
    Candidate c = { .n_light = n_light, .n_lens = n_lens, .pixel = f->pixel, .rgb = rgb, .value = value, .share = share, .reach = reach };
    f->visit(f->context, &c);
}

/* What was found counts 'times', on average once. */
static void find(Found *f, const Walk *walk, Rgb rgb, double times, int n_light, bool direct)
{
    bool joined = n_light > 0 || walk->joined || walk->mode == MODE_NONE;    /* a light that is met could be joined to what is not specular */
    Reach reach = direct ? joined ? REACH_DIRECT : REACH_SEEN : joined ? REACH_INDIRECT : REACH_UNJOINED;
    double value = luminance(rgb);
    if (n_light > 0) value /= path_traced_survival(&vertex(f, walk->edges)->point, walk->edges);    /* as if the walk had gone on to meet it */
    value *= direct ? walk->q : walk->first;
    rgb = scale(times * (direct ? walk->chance : walk->shared), rgb);
    add_found(f, rgb, value, reach, n_light, walk->edges + 1);
}

/* Whether a walk goes on that ought to have at least such a chance; its expectation stays. */
static bool roulette(Walk *walk, double least, Rng *rng)
{
    if (walk->chance >= least) return true;
    if (rng_double(rng) * least >= walk->chance) return false;
    walk->chance = least;
    return true;
}

/* A walk that has arrived at a vertex which is not specular is bent from there on. */
typedef struct { Found *found; const Walk *walk; } Bending;
static void find_bent(void *context, const Bent *bent)
{
    const Bending *b = context;
    Found *f = b->found;
    const Walk *walk = b->walk;
    int edges = walk->edges + bent->d;
    Rgb rgb = scale(1 / (bent->chance_pdf_a + bent->pdf_a), mul(walk->throughput, bent->rgb));
    Reach reach = walk->joined ? REACH_INDIRECT : REACH_UNJOINED;
    double value = walk->first * luminance(rgb);             /* as if the walk had gone on to meet the lamp */
    for (int i = walk->edges; i < edges; i++) value /= path_traced_survival(&vertex(f, i)->point, i);
    add_found(f, scale(walk->shared * bent->times, rgb), value, reach, 0, edges + 1);
}

static void walk_on(Found *f, Walk *walk);

/* The way that the walk does not take at glass, followed for direct light alone. */
static void split(Found *f, Walk *walk)
{
    const Surface *glass = &vertex(f, walk->edges)->point.surface;
    Scatter s;
    Walk other = *walk;
    other.branch = walk->split = other.split = true;
    other.mode = walk->mode == MODE_REFLECT ? MODE_REFRACT : MODE_REFLECT;
    if (!bsdf_follow(glass, walk->known, other.mode, &other.w) || !bsdf_scatter(glass, other.w, walk->known, other.mode, &s)) return;
    if (walk->edges == 1 && f->space->direct != DIRECT_ONLY) {
        double least = path_first_chance(s.q);
        other.branch = rng_double(f->rng) * least >= s.q;
        other.shared = least;
        if (other.branch && f->space->direct == DIRECT_EXCLUDED) return;
    }
    if (other.branch && !roulette(&other, BRANCH_LEAST / s.q, f->rng)) return;
    f->branches--;
    walk_on(f, &other);
}

/* Follows the walk to its end. */
static void walk_on(Found *f, Walk *walk)
{
    const Space *space = f->space;
    const Scene *scene = space->scene;
    Rng *rng = f->rng;
    double pdf_pw = 0;                         /* of the last direction, if light sampling competes with it; else 0 */
    bool only_direct = walk->branch || space->direct == DIRECT_ONLY;
    while (walk->edges < space->max_depth) {
        Vertex *v = vertex(f, walk->edges), *next = v - 1;
        const Surface *from = &v->point.surface, *to = &next->point.surface;
        v->mode = walk->mode;
        if (!scene_trace(scene, &v->point, walk->w, &next->point)) return;
        walk->w = normalize(sub(next->point.p, v->point.p));   /* of the points themselves: what scatters is a function of the path alone */
        if (walk->edges > 0) {
            Scatter s;
            if (!bsdf_scatter(from, walk->w, walk->known, walk->mode, &s) || !(s.inv_S_light > 0)) return;
            walk->throughput = mul(walk->throughput, scale(1 / s.inv_S_light, s.colour));
            walk->q *= s.q;
            if (walk->split) walk->chance *= s.q;
            if (walk->edges == 1) {
                walk->first = path_first_chance(s.q);
                if (walk->split && walk->shared == 1) walk->shared = s.q;
            }
            pdf_pw = walk->mode != MODE_NONE ? 0 : s.inv_S_light / s.inv_F;
        }
        walk->edges++;
        const Material *m = to->material;
        double cos_light = -dot(walk->w, to->ng);
        bool direct = walk->diffuse == 0 || (walk->diffuse == 1 && pdf_pw > 0), specular = material_is_specular(m);
        if (material_emits(m) && cos_light > 0 && (direct ? space->direct != DIRECT_EXCLUDED : !only_direct)) {
            BendLeft left = { 1, 1 };
            if (pdf_pw > 0) {
                Vec3 d = sub(next->point.p, v->point.p);
                double scattering_pdf_a = pdf_pw * cos_light * fabs(dot(walk->w, from->ng)) / dot(d, d);
                left.share = scattering_pdf_a / (scattering_pdf_a + scene_light_preference(scene, &v->point, &next->point) * scene_light_pdf_a(scene, m));
            } else if (!direct && walk->mode != MODE_NONE && space_bends(space, walk->joined)) left = bend_left(scene, next, walk->edges, rng);
            find(f, walk, scale(left.share, mul(walk->throughput, m->ke)), left.times, 0, direct);
        }
        if (walk->edges == space->max_depth) return;
        walk->known = neg(walk->w);
        walk->split = false;
        walk->joined |= !specular && walk->mode == MODE_NONE;
        if (!specular) {
            direct = walk->diffuse == 0;
            if (walk->branch && !roulette(walk, LEAF_LEAST, rng)) return;
            if (direct ? space->direct != DIRECT_EXCLUDED : !only_direct) {
                const double random[3] = { rng_double(rng), rng_double(rng), rng_double(rng) };
                find(f, walk, mul(walk->throughput, sampled_light(space, &next->point, walk->known, direct ? f->numbers->light : random)), 1, 1, direct);
            }
            if (!only_direct && space_bends(space, walk->joined)) {
                const double random[3] = { rng_double(rng), rng_double(rng), rng_double(rng) };
                Bending bending = { f, walk };
                next->mode = MODE_NONE;
                bend_walk(scene, next, space->max_depth - walk->edges, walk->known, random, rng, find_bent, &bending);
            }
            walk->diffuse++;
        }
        if (only_direct && (walk->diffuse > 1 || (walk->diffuse == 1 && specular))) return;
        double survive = path_traced_survival(&next->point, walk->edges);
        if (rng_double(rng) >= survive) return;
        walk->throughput = scale(1 / survive, walk->throughput);
        double disk[2];
        bool first = !specular && walk->diffuse == 1, passes;
        if (first) disk_at(f->numbers->scatter, disk);
        passes = first ? bsdf_sample_at(to, walk->known, disk, rng, &walk->w, &walk->mode) : bsdf_sample(to, walk->known, rng, &walk->w, &walk->mode);
        if (m->kind == MATERIAL_GLASS && walk->diffuse == 0 && (space->direct != DIRECT_EXCLUDED || walk->edges == 1) && f->branches > 0) split(f, walk);
        if (!passes) return;
    }
}

Numbers numbers_random(Rng *rng)
{
    union { Numbers named; double u[NUMBERS]; } all;
    for (int i = 0; i < NUMBERS; i++) all.u[i] = rng_double(rng);
    return all.named;
}

Rgb path_trace(const Space *space, uint32_t column, uint32_t row, const Numbers *numbers, Rng *rng, Path *trail,
               void (*visit)(void *context, const Candidate *), void *context)
{
    const Camera *camera = &space->scene->camera;
    if (space->scene->n_lights == 0) return vec3(0, 0, 0);
    double disk[2] = { 0, 0 };
    Found found = { .space = space, .pixel = row * camera->width + column, .numbers = numbers, .rng = rng, .trail = trail, .branches = BRANCHES, .visit = visit,
                    .context = context };
    Walk walk = { .mode = MODE_NONE, .throughput = { 1, 1, 1 }, .q = 1, .first = 1, .shared = 1, .chance = 1 };
    Point *lens = &vertex(&found, 0)->point;
    if (camera->aperture > 0) disk_at(numbers->lens, disk);
    camera_lens_at(camera, disk, lens);
    walk.w = camera_direction(camera, lens, column + numbers->film[0], row + numbers->film[1]);
    walk_on(&found, &walk);
    return found.sum;
}

bool path_trailed(const Space *space, const Path *trail, int n_lens, Path *out)
{
    out->k = n_lens - 1;
    memcpy(out->v, trail->v + MAX_EDGES + 1 - n_lens, (size_t)n_lens * sizeof out->v[0]);
    return path_evaluate(space, out);
}
