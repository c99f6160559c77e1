/* Path space: paths from a light to the lens, the integrand f, and the two ratios C and S of which every probability ratio is made.
 *
 *   x = x_0 x_1 .. x_k     x_0 on a light, x_k on the lens, k >= 1 edges                           [lecture: Review; What to integrate]
 *   F_i                    scalar scattering at x_i: L_e at x_0, the largest channel of f_s inside, W_e at x_k
 *   G_i                    G(x_i, x_{i+1}), visibility apart
 *   C_i = F_i G_i F_{i+1}  cost of joining x_i and x_{i+1}                                         [lecture: Precomputation]
 *   S>_i = F_i / p>_i      at a vertex from which the next one towards the lens was sampled, p per projected solid angle
 *   S<_i = F_i / p<_i      the same towards the light
 *   chi                    share w(pixel) luminance(product of f_s^rgb / F_i): f* = chi * product of F and G is the sampler's target;
 *                          share: how much of f is left to the sampler (Space), 1 where path space is not divided
 *
 * The code holds 1/C and 1/S: a way of sampling that does not exist is then simply 0. Ends: S>_{-1} = 1/p_A(x_0), C_{-1} = L_e (an eye
 * subpath that meets the light by itself), S<_k = S<_{k+1} = 1 (raster position uniform over the film; point uniform over the lens).
 * Roles, not materials: x_0 emits and x_k measures, even where x_0 lies on a mirror.
 * Knows no mutations and no chain. */
#ifndef PATH_H
#define PATH_H
#include "emission.h"
#include "scene.h"

enum { MAX_EDGES = 255 };          /* the longest path that --max-depth can ask for */

typedef struct {
    Point point;
    Mode mode;                     /* of a specular vertex between the ends; else MODE_NONE */
    Scatter s;                     /* cached by path_scatter */
    Vec3 to_lens;                  /* unit, to the next vertex; cached by path_edge, like inv_G */
    double inv_G;
} Vertex;

/* What a way through specular vertices tells of the others near it (specular.h). */
typedef struct {
    double spread;                 /* |dw/dx_0|: solid angle at the vertex that it comes to over area at x_0; with nothing between it would be cos/r^2 */
    double basin;                  /* the solid angle there about w from which a search is likely to find this way, roughly */
    bool through;                  /* refraction alone, and a search from the straight line to the lamp is likely to find it */
} SpecularWay;

typedef struct {
    int k;                         /* edges */
    struct { Vec3 at[4]; int d; SpecularWay way; } known;      /* the last way that was asked for, and where it goes: it takes rays to tell */
    double raster_x, raster_y;     /* where the last edge meets the film, pixels */
    uint32_t pixel;                /* row-major index of that pixel */
    double light_pdf_a;            /* p_A(x_0), per area */
    Rgb colour;                    /* product of f_s^rgb / F, light and lens included */
    double value;                  /* by which it is capped (path_traced_value, path_bidirectional_value); 0 while the integrand is whole */
    double share, chi;
    Vertex v[MAX_EDGES + 1];
} Path;

/* How light reaches the lens: indirectly, by a path that has an edge without a specular end or by one that has none, L S+ D S+ E and longer ones;
 * directly, exactly L D? S* E: every vertex between x_1 and the lens is specular; and of direct light that which is seen by way of specular vertices
 * alone, L S+ E. The second and the last cannot be joined anywhere: all that finds them is a walk that meets the light (or the lens) by itself. */
typedef enum { REACH_INDIRECT, REACH_UNJOINED, REACH_DIRECT, REACH_SEEN } Reach;
static inline bool reach_is_direct(Reach reach) { return reach >= REACH_DIRECT; }

/* Which paths count. */
typedef enum { DIRECT_INCLUDED, DIRECT_EXCLUDED, DIRECT_ONLY } DirectClass;

/* What belongs to a pixel, in one line of memory: a chain meets pixels in no order, and each is a cache miss. */
typedef struct {
    float weight;                  /* w of the two-stage target */
    float threshold;               /* the largest luminance that an independent sample of one path may have, where f is divided */
    float halves;                  /* weights of states recorded in the first halves of chains, less those in the second; like sum[], not for the space */
    double sum[3];                 /* recorded by the chains */
} Pixel;

/* The integrand as a whole, or divided between independent samples and chains: of a path whose estimate by a sample (path_traced_value or
 * path_bidirectional_value) is above the threshold, CAPPED keeps so much that it is just that; REST is what is left of f. Direct light that is not
 * REACH_SEEN has no threshold. */
typedef enum { WHOLE, CAPPED, REST } Part;

/* Which walks from the lens independent samples also bend through specular vertices, to meet a lamp (bend.h): those whose paths could not be joined
 * anywhere, L S+ D S+ E (REACH_UNJOINED), or all. */
typedef enum { BENT_NONE, BENT_UNJOINED, BENT_ALL, BENDINGS } BentWalks;

/* The space that is integrated over. */
typedef struct Space {
    const Scene *scene;
    int max_depth;                 /* longest path in edges */
    DirectClass direct;
    const Pixel *film;             /* [pixels]; NULL for w = 1 and the WHOLE */
    Part part;
    double seen;                   /* REACH_SEEN has its threshold at so many times that of indirect light */
    BentWalks bent;
    const Emission *emission;      /* which way light subpaths of samples leave their lamp, not a mutation's; NULL: by the cosine law */
    bool bidirectional;            /* indirect light is capped by its value to a bidirectional path tracer; the path tracer has at most direct light then */
    const struct Space *divided;   /* by whose values it is capped, where samples bend more walks than the values know of; NULL: by its own */
} Space;
static inline const Space *space_divided(const Space *space) { return space->divided ? space->divided : space; }

/* Whether walks are bent of whose edges so far some, or none, could be joined. */
static inline bool space_bends(const Space *space, bool joined) { return space->bent == BENT_ALL || (space->bent == BENT_UNJOINED && !joined); }

/* A path that an independent sample found, by joining n_light vertices grown from the light to n_lens grown from the lens
 * (n_light >= 0, n_lens >= 1, k = n_light + n_lens - 1 edges). */
typedef struct {
    int n_light, n_lens;
    uint32_t pixel;
    Rgb rgb;                   /* f / sum of the densities of all techniques (balance heuristic), whatever its share; in expectation, where a walk goes both ways at glass */
    double weight;             /* the same of the target f*: luminance times w(pixel), times the share */
    double value;              /* by which it is capped, if the space has a film: path_traced_value, or path_bidirectional_value */
    double share;              /* of f that the space holds */
    Reach reach;               /* path_reach */
} Candidate;

/* Copies k, ends' caches and the k+1 vertices that the path has. */
void path_copy(Path *to, const Path *from);

/* Extends the path by one vertex that is sampled from what is there; the new vertex's point and mode-giving neighbour are set, and the
 * edge between. Towards the lens: v[i+1] from v[i], v[i-1] (i = -1: a light point; i = 0: emission). Towards the light: v[i-1] from v[i],
 * v[i+1] (i = k+1: a lens point; i = k: a raster position). The caller keeps path->k right for the latter.
 * False if the ray is lost, or the sample fell below the surface. */
bool path_grow_to_lens(const Space *space, Path *path, int i, Rng *rng);
bool path_grow_to_light(const Space *space, Path *path, int i, Rng *rng);

/* v[1] from v[0], like path_grow_to_lens, but by Space.emission. */
bool path_leave_lamp(const Space *space, Path *path, Rng *rng);
/* Its density over that of path_grow_to_lens, for light that leaves a lamp's point in the unit direction w, above its surface. */
double path_emission_ratio(const Space *space, const Point *lamp, Vec3 w);

/* Sets v[k-1] to what the lens point v[k] sees at a raster position (pixels). False if nothing is there. */
bool path_look(const Space *space, Path *path, double x, double y);

/* Computes to_lens and inv_G of the edge from v[i] to v[i+1]. False if G is 0 or not finite. */
bool path_edge(Path *path, int i);

/* Computes the caches of v[i] in its role (x_0: light; x_k: lens and raster position; else scattering) from the edges on both sides of it.
 * False if nothing passes. */
bool path_scatter(const Space *space, Path *path, int i);

/* Computes colour, share and chi; chi = 0 where the path is not in the space (too long, of the excluded class, or left to independent samples). */
void path_finish(const Space *space, Path *path);

/* All caches from the points and modes alone: what path_edge, path_scatter and path_finish hold. Visibility is not tested. */
bool path_evaluate(const Space *space, Path *path);

Reach path_reach(const Path *path);

/* Luminance of f/p, p the density with which a path tracer finds the path: growing it from the lens until it meets the light by itself, or
 * joining x_1 to a sampled light point (the balance heuristic over both), Russian roulette included as far as the first of them meets it. At glass it draws
 * the mode, and p has the mode's chance in it, but for direct light, for which it goes both ways, and at the first vertex (path_first_chance). */
double path_traced_value(const Space *space, Path *path);
/* The same of a bidirectional path tracer (bdpt.h), Russian roulette included. */
double path_bidirectional_value(const Space *space, Path *path);
/* Its chance to go on from a point, a function of that alone so that every technique can tell it. */
static inline double path_survival(const Point *point) { return bsdf_albedo(&point->surface); }
/* The path tracer's chance, at a point so many edges from the lens. */
static inline double path_traced_survival(const Point *point, int edges) { return edges < 3 ? 1 : path_survival(point); }
/* The chance of a mode that a path tracer's walk has at its first vertex: of glass it follows both, the rarer of them at least so often. */
static inline double path_first_chance(double q) { return q < 0.125 ? 0.125 : q; }
/* How much of f the space holds of a path of this value in this pixel. */
static inline double space_share(const Space *space, uint32_t pixel, double value, Reach reach)
{
    if (space->part == WHOLE) return 1;
    double most = (double)space->film[pixel].threshold;
    if (reach == REACH_SEEN) most *= space->seen;
    double capped = value > most && reach != REACH_DIRECT ? most / value : 1;
    return space->part == REST ? 1 - capped : capped;
}

/* v[i] scatters at a specular surface (never true at the ends). */
static inline bool path_specular(const Path *p, int i)
{
    return i > 0 && i < p->k && p->v[i].mode != MODE_NONE;
}

/* Light leaves v[i] in nearly one direction: perturbations take a narrow lobe for specular. */
static inline bool path_sharp(const Path *p, int i) { return path_specular(p, i) || (i > 0 && i < p->k && p->v[i].s.narrow); }

/* How light passes v[i] from the lens towards the light, or the other way. */
static inline Passage path_passage(const Path *p, int i, bool to_light)
{
    const Vertex *v = &p->v[i];
    Vec3 lens = v->to_lens, light = neg(v[-1].to_lens);
    return bsdf_passage(&v->point.surface, to_light ? lens : light, to_light ? light : lens, v->mode);
}

/* 1/C_i for -1 <= i <= k; 0 where that join does not exist (specular ends; beyond the lens). */
static inline double path_inv_C(const Path *p, int i)
{
    if (i < 0) return p->v[0].s.inv_F;
    return i < p->k ? p->v[i].s.inv_F * p->v[i].inv_G * p->v[i + 1].s.inv_F : 0;
}
/* 1/S>_i for -1 <= i < k */
static inline double path_inv_S_lens(const Path *p, int i) { return i < 0 ? p->light_pdf_a : p->v[i].s.inv_S_lens; }
/* 1/S<_i for 0 < i <= k+1 */
static inline double path_inv_S_light(const Path *p, int i) { return i <= p->k ? p->v[i].s.inv_S_light : 1; }

/* Sum over the ways j of 1/Q_j: all routes by which the vertices between v[s] and v[t] can be regrown, some from v[s], the others from v[t],
 * joined at one edge. chi Q_j = f / density of way j, in which every G but the joined edge's cancels.   [lecture: T must take all routes into account]
 *   1/Q_j = prod_{i=s}^{e-1} 1/S>_i * 1/C_e * prod_{i=e+2}^{t} 1/S<_i,   e = s + j the joined edge
 * -1 <= s < t <= k+1. With s = -1, t = k+1 it is chi times the sum of p / f over all bidirectional techniques. */
static inline double path_routes(const Path *p, int s, int t)
{
    double sum = path_inv_C(p, s), grown = 1;
    for (int e = s + 1; e < t; e++) {          /* one vertex more: the old joins gain S< at its far end, and there is one join more */
        grown *= path_inv_S_lens(p, e - 1);
        sum = sum * path_inv_S_light(p, e + 1) + grown * path_inv_C(p, e);
    }
    return sum;
}
#endif
