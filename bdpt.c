/* Bidirectional path tracing. [Veach ch. 10]
 *
 * The bidirectional weight needs no densities of its own: with the balance heuristic a candidate counts f / (sum of p over all techniques),
 * and that sum over f is path_routes(-1, k+1), made of 1/C and 1/S. Only the two joined vertices differ from one technique to the next,
 * so the sum is split into a prefix over the light subpath and a suffix over the lens subpath, and each join costs a constant.
 * Russian roulette: a subpath goes on from a vertex with the probability 'survival' of its surface; 1/S is multiplied by it.
 * Where the lens sees glass, the lens subpath goes both ways, the rarer one by roulette, and both are joined to the light subpath. In the densities p each
 * way has its mode's chance q; a candidate counts so much that its expectation is as if only one of them had been drawn.
 */
#include "bdpt.h"
#include "bend.h"
#include <stdlib.h>
#include <string.h>

struct Bdpt {
    Path light, lens;                          /* lens subpath: its vertex j is lens.v[MAX_EDGES - j], x_k is j = 0 */
    int n_light, n_lens;
    /* Prefix after light vertex t: 'sum' over joins at edges before t, 'grown' the density of having grown v[0..t] alone; all over f. */
    double sum[MAX_EDGES + 1], grown[MAX_EDGES + 1];
    double traced[MAX_EDGES + 1];              /* like sum, over the path tracer's techniques alone, without Russian roulette */
    double preference;                         /* the path tracer's, for light vertex 0, at light vertex 1 */
    double light_survival[MAX_EDGES + 1];      /* of the path tracer's, product over light vertices 1 .. t */
    /* Suffix at lens vertex j: the whole sum is sum * alpha + grown * beta, both taken at that vertex. */
    double alpha[MAX_EDGES + 1], beta[MAX_EDGES + 1], plain[MAX_EDGES + 1];   /* plain: alpha without Russian roulette */
    Rgb light_colour[MAX_EDGES + 1], lens_colour[MAX_EDGES + 1];   /* products of colour up to and with this vertex */
    int lens_diffuse[MAX_EDGES + 1];           /* non-specular vertices among lens vertices 1..j */
    bool lens_joined[MAX_EDGES + 1];           /* whether any edge up to lens vertex j could be joined */
    double lens_survival[MAX_EDGES + 1];       /* over lens vertices 3 .. j */
    double lens_q[MAX_EDGES + 1];              /* product of the modes' chances at them */
    double counts;                             /* of its value, what a candidate counts that has more lens vertices than two */
    Path whole;                                /* a candidate's, where walks are bent */
};

Bdpt *bdpt_new(void) { return calloc(1, sizeof(Bdpt)); }
void bdpt_free(Bdpt *bdpt) { free(bdpt); }

static Vertex *lens_vertex(const Bdpt *b, int j) { return (Vertex *)&b->lens.v[MAX_EDGES - j]; }

static void with_survival(Vertex *v)
{
    double r = path_survival(&v->point);
    v->s.inv_S_lens *= r;
    v->s.inv_S_light *= r;
}

/* The path tracer's preference for a light, for its values; without a film nobody asks for these. */
static double preference(const Space *space, const Point *at, const Point *light)
{
    return space->film ? scene_light_preference(space->scene, at, light) : 1;
}

/* Of light that leaves a lamp's point in the unit direction w. */
static Scatter emission(const Space *space, const Point *lamp, Vec3 w)
{
    Scatter s = bsdf_emission(lamp->surface.material);
    s.inv_S_lens *= path_emission_ratio(space, lamp, w);
    return s;
}

static void trace_light(Bdpt *b, const Space *space, Rng *rng)
{
    Path *p = &b->light;
    p->k = MAX_EDGES;
    path_grow_to_lens(space, p, -1, rng);
    const Material *m = p->v[0].point.surface.material;
    p->light_pdf_a = scene_light_pdf_a(space->scene, m);
    p->v[0].s = bsdf_emission(m);
    b->traced[0] = b->sum[0] = p->v[0].s.inv_F;
    b->light_survival[0] = 1;
    b->grown[0] = p->light_pdf_a;
    b->light_colour[0] = p->v[0].s.colour;
    b->n_light = 1;
    for (int i = 0; i < space->max_depth - 1; i++) {
        if (i > 0 && rng_double(rng) >= path_survival(&p->v[i].point)) return;
        if (!(i > 0 ? path_grow_to_lens(space, p, i, rng) : path_leave_lamp(space, p, rng))) return;
        if (i > 0) {                           /* v[i] is now known from both sides */
            if (!path_scatter(space, p, i)) return;
            double inv_C = path_inv_C(p, i - 1);
            b->traced[i] = b->traced[i - 1] * p->v[i].s.inv_S_light + (i == 1 ? b->preference * b->grown[0] * inv_C : 0);
            with_survival(&p->v[i]);
            b->sum[i] = b->sum[i - 1] * p->v[i].s.inv_S_light + b->grown[i - 1] * inv_C;
            b->grown[i] = b->grown[i - 1] * p->v[i - 1].s.inv_S_lens;
            b->light_colour[i] = mul(b->light_colour[i - 1], p->v[i].s.colour);
        }
        else {
            p->v[0].s = emission(space, &p->v[0].point, p->v[0].to_lens);
            b->preference = preference(space, &p->v[1].point, &p->v[0].point);
        }
        b->light_survival[i + 1] = b->light_survival[i] * path_survival(&p->v[i + 1].point);
        b->n_light = i + 2;
    }
}

/* Of the path of lens vertices alone that a bent walk has made. */
typedef struct { Bdpt *bdpt; const Space *space; int n_lens; void (*visit)(void *, const Candidate *); void *context; } Bending;
static void join_bent(void *context, const Bent *bent)
{
    const Bending *of = context;
    Path *p = &of->bdpt->whole;
    int n_lens = of->n_lens + bent->d;
    if (!bdpt_path(of->bdpt, space_divided(of->space), 0, n_lens, p) || luminance(p->colour) == 0) return;
    double sum = path_bidirectional_value(of->space, p) / luminance(p->colour), weight = of->space->film ? (double)of->space->film[p->pixel].weight : 1;
    Candidate c = { .n_lens = n_lens, .pixel = p->pixel, .rgb = scale(of->bdpt->counts * bent->times * sum, p->colour), .value = p->value, .share = p->share, .reach = path_reach(p) };
    c.weight = c.share * luminance(c.rgb) * weight;
    if (c.weight != 0 && !(of->space->part == REST && c.reach == REACH_UNJOINED)) of->visit(of->context, &c);     /* NaN too: it is counted */
}

/* The lens point and what it sees at (x, y). False if that is nothing. */
static bool look(Bdpt *b, const Space *space, double x, double y, const Numbers *numbers, Rng *rng)
{
    Path *p = &b->lens;
    double disk[2] = { 0, 0 };
    p->k = MAX_EDGES;
    path_grow_to_light(space, p, p->k + 1, rng);
    if (numbers) {
        if (space->scene->camera.aperture > 0) disk_at(numbers->lens, disk);
        camera_lens_at(&space->scene->camera, disk, &p->v[p->k].point);
    }
    b->n_lens = 1;
    b->alpha[0] = b->plain[0] = b->counts = 1;
    b->beta[0] = 0;
    b->lens_colour[0] = vec3(1, 1, 1);
    b->lens_diffuse[0] = 0;
    b->lens_q[0] = b->lens_survival[0] = b->lens_survival[1] = 1;
    b->lens_joined[0] = false;
    if (!path_look(space, p, x, y) || !path_scatter(space, p, p->k)) return false;
    b->n_lens = 2;
    return true;
}

/* Lens vertex j, from which the subpath has been grown by one, is now known from both sides. False if nothing passes it. */
static bool go_on(Bdpt *b, const Space *space, int j)
{
    Path *p = &b->lens;
    int i = MAX_EDGES - j;
    if (!path_scatter(space, p, i)) return false;
    with_survival(&p->v[i]);
    b->alpha[j] = b->alpha[j - 1] * p->v[i + 1].s.inv_S_light;
    b->plain[j] = b->plain[j - 1] * p->v[i + 1].s.inv_S_light / (j > 1 ? path_survival(&p->v[i + 1].point) : 1);
    b->beta[j] = b->alpha[j - 1] * path_inv_C(p, i) + b->beta[j - 1] * p->v[i].s.inv_S_lens;
    b->lens_colour[j] = mul(b->lens_colour[j - 1], p->v[i].s.colour);
    b->lens_diffuse[j] = b->lens_diffuse[j - 1] + (p->v[i].mode == MODE_NONE);
    b->lens_joined[j] = b->lens_joined[j - 1] || (p->v[i].mode == MODE_NONE && (j == 1 || p->v[i + 1].mode == MODE_NONE));
    b->lens_q[j] = b->lens_q[j - 1] * p->v[i].s.q;
    b->lens_survival[j + 1] = b->lens_survival[j] * path_traced_survival(&p->v[i - 1].point, j + 1);
    b->n_lens = j + 2;
    return true;
}

/* Grows the lens subpath by one from its vertex j, by given numbers where that is the first which is not specular. */
static bool grow_lens(Bdpt *b, const Space *space, int j, const Numbers *numbers, Rng *rng)
{
    Path *p = &b->lens;
    int i = MAX_EDGES - j;
    Vertex *v = &p->v[i], *next = v - 1;
    double disk[2];
    Vec3 w;
    if (!numbers || b->lens_diffuse[j - 1] > 0 || material_is_specular(v->point.surface.material)) return path_grow_to_light(space, p, i, rng);
    disk_at(numbers->scatter, disk);
    next->mode = MODE_NONE;
    return bsdf_sample_at(&v->point.surface, v->to_lens, disk, rng, &w, &v->mode) && scene_trace(space->scene, &v->point, w, &next->point) && path_edge(p, i - 1);
}

/* Grows the lens subpath on from its vertex j; walks that are bent on the way find their candidates at once. */
static void trace_lens(Bdpt *b, const Space *space, int j, FirstGlass glass, const Numbers *numbers, Rng *rng, void (*visit)(void *, const Candidate *), void *context)
{
    Path *p = &b->lens;
    for (; j < space->max_depth; j++) {
        int i = MAX_EDGES - j;
        bool joined = j == 1 || b->lens_joined[j - 1] || p->v[i + 1].mode == MODE_NONE;      /* to v[i], if it is not specular */
        if (space_bends(space, joined) && space->direct != DIRECT_ONLY && !material_is_specular(p->v[i].point.surface.material)) {
            const double light[3] = { rng_double(rng), rng_double(rng), rng_double(rng) };
            Bending bending = { b, space, j + 1, visit, context };
            p->v[i].mode = MODE_NONE;
            bend_walk(space->scene, &p->v[i], space->max_depth - j, p->v[i].to_lens, light, rng, join_bent, &bending);
        }
        if (rng_double(rng) >= path_survival(&p->v[i].point) || !grow_lens(b, space, j, numbers, rng) || !go_on(b, space, j)) return;
        if (j == 1) b->counts = (glass == BOTH_WAYS ? p->v[i].s.q : 1) / path_first_chance(p->v[i].s.q);
    }
}

/* Turns to the way that the lens subpath has not taken at glass, and grows it by one. False if it has taken none, or by roulette. */
static bool turn(Bdpt *b, const Space *space, Rng *rng)
{
    int i = MAX_EDGES - 1;
    Path *p = &b->lens;
    Vertex *v = &p->v[i];
    Vec3 w;
    Scatter s;
    if (b->n_lens < 2 || v->point.surface.material->kind != MATERIAL_GLASS || v->mode == MODE_NONE) return false;
    v->mode = v->mode == MODE_REFLECT ? MODE_REFRACT : MODE_REFLECT;
    b->n_lens = 2;
    b->counts = 1;
    if (!bsdf_follow(&v->point.surface, v->to_lens, v->mode, &w) || !bsdf_scatter(&v->point.surface, w, v->to_lens, v->mode, &s)) return false;
    if (rng_double(rng) * path_first_chance(s.q) >= s.q) return false;
    p->v[i - 1].mode = MODE_NONE;
    return scene_trace(space->scene, &v->point, w, &p->v[i - 1].point) && path_edge(p, i - 1) && go_on(b, space, 1);
}

/* Direct light is L D? S* E: of the lens vertices 1 .. k-2 none may be non-specular, and the joined ones always are. */
static Reach reach(const Bdpt *b, int n_light, int n_lens)
{
    int k = n_light + n_lens - 1;
    bool joined = n_light > 0 || k < 2 || b->lens_joined[k - 1] || lens_vertex(b, k - 1)->mode == MODE_NONE;
    if (k >= 3 && (n_light > 1 || b->lens_diffuse[k - 2] > 0)) return joined ? REACH_INDIRECT : REACH_UNJOINED;
    return joined ? REACH_DIRECT : REACH_SEEN;
}

static bool counts(const Bdpt *b, const Space *space, int n_light, int n_lens)
{
    int k = n_light + n_lens - 1;
    if (k > space->max_depth) return false;
    return space->direct == DIRECT_INCLUDED || reach_is_direct(reach(b, n_light, n_lens)) == (space->direct == DIRECT_ONLY);
}

/* One more vertex in the recurrence of path_routes; 'r' is what Russian roulette has put into to->inv_S_light; 'preference' the path tracer's for the
 * light, at the vertex after it. */
typedef struct { double sum, grown, traced, preference; int vertices; } Routes;
static Routes extend(Routes a, const Scatter *from, double inv_G, const Scatter *to, double r)
{
    double joined = a.grown * (from->inv_F * inv_G * to->inv_F);
    return (Routes){ a.sum * to->inv_S_light + joined, a.grown * from->inv_S_lens, a.traced * to->inv_S_light / r + (a.vertices == 1 ? a.preference * joined : 0),
                     a.preference, a.vertices + 1 };
}

static bool specular_at_light(const Bdpt *b, int n_light, int n_lens)
{
    return n_light == 0 ? n_lens > 2 && lens_vertex(b, n_lens - 2)->mode != MODE_NONE : n_light > 2 && b->light.v[1].mode != MODE_NONE;
}

/* How often a path counts that met the lamp by chance beyond specular vertices, where walks are bent. These have been grown by Russian roulette, bent ones not. */
static double times_by_chance(const Bdpt *b, const Space *space, int n_lens, Rng *rng)
{
    Vertex *v = lens_vertex(b, n_lens - 1);
    BendLeft left = bend_left(space->scene, v, n_lens - 1, rng);
    double survival = 1;
    for (int i = 1; ; i++) {
        survival *= path_survival(&v[i].point);
        if (v[i].mode == MODE_NONE) break;
    }
    return 1 + (left.times - 1) / survival;
}

/* Fills the candidate of n_light and n_lens vertices; false if it carries nothing. */
static bool join(Bdpt *b, const Space *space, int n_light, int n_lens, Rng *rng, Candidate *c)
{
    const Vertex *lens = lens_vertex(b, n_lens - 1);
    double x = b->lens.raster_x, y = b->lens.raster_y;
    Scatter at_lens;
    Routes routes;
    Rgb colour;
    if (n_light == 0) {                        /* the lens subpath met a light by itself */
        const Material *m = lens->point.surface.material;
        if (!material_emits(m) || dot(lens->to_lens, lens->point.surface.ng) <= 0) return false;
        at_lens = emission(space, &lens->point, lens->to_lens);
        double preferred = n_lens > 2 ? preference(space, &lens[1].point, &lens->point) : 1;
        routes = (Routes){ at_lens.inv_F, scene_light_pdf_a(space->scene, m), at_lens.inv_F, preferred, 1 };
        colour = at_lens.colour;
    } else {
        const Vertex *light = &b->light.v[n_light - 1];
        if ((n_light > 1 && material_is_specular(light->point.surface.material)) || (n_lens > 1 && material_is_specular(lens->point.surface.material)))
            return false;
        Vec3 d = sub(lens->point.p, light->point.p);
        double squared = dot(d, d), we, cos_light, cos_lens;
        Vec3 w = scale(1 / sqrt(squared), d);
        cos_light = dot(w, light->point.surface.ng);
        cos_lens = dot(w, lens->point.surface.ng);
        double inv_G = squared / fabs(cos_light * cos_lens);
        if (!(inv_G > 0) || !(inv_G < INFINITY)) return false;
        Scatter at_light = light->s;
        if (n_light == 1) {
            if (cos_light <= 0) return false;
            double preferred = n_lens > 1 ? preference(space, &lens->point, &light->point) : 1;
            routes = (Routes){ b->sum[0], b->grown[0], b->traced[0], preferred, 1 };
            at_light = emission(space, &light->point, w);
            colour = at_light.colour;
        } else {
            if (!bsdf_scatter(&light->point.surface, neg(light[-1].to_lens), w, MODE_NONE, &at_light)) return false;
            double r = path_survival(&light->point);
            at_light.inv_S_lens *= r;
            at_light.inv_S_light *= r;
            routes = extend((Routes){ b->sum[n_light - 2], b->grown[n_light - 2], b->traced[n_light - 2], b->preference, n_light - 1 }, &light[-1].s,
                            light[-1].inv_G, &at_light, r);
            colour = mul(b->light_colour[n_light - 2], at_light.colour);
        }
        double r_lens = 1;
        if (n_lens == 1) {
            if (!camera_project(&space->scene->camera, &lens->point, neg(w), &x, &y, &we)) return false;
            at_lens = (Scatter){ vec3(1, 1, 1), 1 / we, 0, 1, 1, false };
        } else {
            if (!bsdf_scatter(&lens->point.surface, neg(w), lens->to_lens, MODE_NONE, &at_lens)) return false;
            r_lens = path_survival(&lens->point);
            at_lens.inv_S_lens *= r_lens;
            at_lens.inv_S_light *= r_lens;
            colour = mul(colour, at_lens.colour);
        }
        routes = extend(routes, &at_light, inv_G, &at_lens, r_lens);
    }
    double total = routes.sum, traced = routes.traced;
    if (n_lens > 1) {
        routes = extend(routes, &at_lens, lens->inv_G, &lens[1].s, n_lens > 2 ? path_survival(&lens[1].point) : 1);
        total = routes.sum * b->alpha[n_lens - 2] + routes.grown * b->beta[n_lens - 2];
        traced = routes.traced * b->plain[n_lens - 2];
        colour = mul(colour, b->lens_colour[n_lens - 2]);
    }
    if (n_light + n_lens == 2) traced = n_light == 0 ? at_lens.inv_F : b->traced[0];   /* a path tracer samples no light to the lens itself */
    int k = n_light + n_lens - 1, last = n_light - 1 < k - 3 ? n_light - 1 : k - 3;     /* light vertex that is three edges from the lens, or more */
    traced *= b->lens_survival[n_light == 0 ? k - 1 : n_lens - 1] * b->light_survival[last > 0 ? last : 0];
    c->pixel = (uint32_t)y * space->scene->camera.width + (uint32_t)x;
    c->reach = reach(b, n_light, n_lens);
    bool direct = reach_is_direct(c->reach);
    double first = n_lens > 2 ? path_first_chance(b->lens_q[1]) : 1;
    c->value = luminance(colour) / (space->bidirectional && !direct ? total : traced);
    if (direct && n_lens > 1) c->value *= b->lens_q[n_lens - 2];
    else if (!direct) c->value *= first;
    c->share = space_share(space, c->pixel, c->value, c->reach);
    if (!(c->share > 0) || (space->part == REST && c->reach == REACH_UNJOINED)) return false;
    if (n_light > 0 && !scene_visible(space->scene, &b->light.v[n_light - 1].point, &lens->point)) return false;
    if (!direct && specular_at_light(b, n_light, n_lens) && space_bends(space, c->reach == REACH_INDIRECT)) {
        if (!bdpt_path(b, space_divided(space), n_light, n_lens, &b->whole)) return false;
        total = first * luminance(b->whole.colour) / path_bidirectional_value(space, &b->whole);
        if (n_light == 0) total /= times_by_chance(b, space, n_lens, rng);
        c->value = b->whole.value;
        c->share = b->whole.share;
    }
    c->n_light = n_light;
    c->n_lens = n_lens;
    c->rgb = scale((n_lens > 2 ? b->counts * first : 1) / total, colour);
    c->weight = c->share * luminance(c->rgb) * (space->film ? (double)space->film[c->pixel].weight : 1);
    return c->weight > 0;
}

static void join_all(Bdpt *b, const Space *space, int least_lens, Rng *rng, void (*visit)(void *, const Candidate *), void *context)
{
    Candidate c;
    for (int n_light = 0; n_light <= b->n_light; n_light++)
        for (int n_lens = n_light == 0 && least_lens < 2 ? 2 : least_lens; n_lens <= b->n_lens; n_lens++)
            if (counts(b, space, n_light, n_lens) && join(b, space, n_light, n_lens, rng, &c)) visit(context, &c);
}

void bdpt_sample(Bdpt *b, const Space *space, double x, double y, FirstGlass glass, const Numbers *numbers, Rng *rng, void (*visit)(void *, const Candidate *), void *context)
{
    if (space->scene->n_lights == 0) return;
    trace_light(b, space, rng);
    if (look(b, space, x, y, numbers, rng)) trace_lens(b, space, 1, glass, numbers, rng, visit, context);
    join_all(b, space, 1, rng, visit, context);
    if (glass == ONE_WAY || !turn(b, space, rng)) return;
    trace_lens(b, space, 2, glass, numbers, rng, visit, context);
    join_all(b, space, 3, rng, visit, context);
}

double bdpt_value(const Bdpt *b, const Candidate *c) { return luminance(c->rgb) / (c->n_lens > 2 ? b->counts : 1); }

const char *const path_class_name[CLASSES] = {
    "direct light", "diffuse reflection", "caustics", "caustics seen through glass, water or mirrors", "other specular reflection"
};

bool bdpt_may_be_bent(const Bdpt *b, const Candidate *c) { return !reach_is_direct(c->reach) && specular_at_light(b, c->n_light, c->n_lens); }

PathClass bdpt_class(const Bdpt *b, const Candidate *c)
{
    if (reach_is_direct(c->reach)) return CLASS_DIRECT;
    /* specular vertices: light 1 .. last_light, lens 1 .. last_lens; those joined never are */
    int last_light = c->n_light - 2, last_lens = c->n_lens - 2;
    bool at_lens = last_lens > 0 && lens_vertex(b, 1)->mode != MODE_NONE;
    if (specular_at_light(b, c->n_light, c->n_lens)) return at_lens ? CLASS_CAUSTIC_SEEN : CLASS_CAUSTIC;
    bool any = last_lens > 0 && b->lens_diffuse[last_lens] < last_lens;
    for (int i = 1; i <= last_light && !any; i++) any = b->light.v[i].mode != MODE_NONE;
    return any ? CLASS_SPECULAR : CLASS_DIFFUSE;
}

bool bdpt_path(const Bdpt *b, const Space *space, int n_light, int n_lens, Path *out)
{
    out->k = n_light + n_lens - 1;
    memcpy(out->v, b->light.v, (size_t)n_light * sizeof out->v[0]);
    memcpy(out->v + n_light, lens_vertex(b, n_lens - 1), (size_t)n_lens * sizeof out->v[0]);
    /* joined vertices scatter diffusely, whatever they did when the subpath went on from them */
    if (n_light > 0) out->v[n_light - 1].mode = MODE_NONE;
    out->v[n_light].mode = MODE_NONE;
    return path_evaluate(space, out);
}
