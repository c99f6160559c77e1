/* A slow, plain evaluation of f(x) and T(y|x) in full product area measure, nothing cancelled: what test_ratio.c holds the renderer against.
 * Written from the formulas of the lecture and of doc/lecture.md, not from path.c, mutate.c or perturb.c.
 *
 *   f(x)   = L_e prod G f_s W_e, per dA for every vertex (thin lens: per dA/A_lens; pinhole: a delta that is in f and in T)
 *   T(y|x) = probability of the label times the density of y's new vertices, per dA of each
 *
 * Specular vertices. A density 'towards the light' carries delta(w_L - t(w_E))/|w_L.n_g|, with t the law of the mode; f carries the same delta,
 * times rho (eta_E/eta_L)^2, since radiance scales so. A density 'towards the lens' carries delta(w_E - t(w_L))/|w_E.n_g|. At one point of the
 * surface  eta^2 |w.n_s| dw  is conserved by reflection and by refraction (n_s is what the law uses), so that
 *     delta_lens / delta_light = (|w_L.n_g| / |w_E.n_g|) dw_L/dw_E = (eta_E/eta_L)^2 |w_L.n_g| |w_E.n_s| / ( |w_E.n_g| |w_L.n_s| ).
 * Everything below is per delta_light, so f, p< and p> of a specular vertex are plain numbers (test_bsdf.c measures dw_L/dw_E).
 *
 * Faults that tests plant are switched on here and nowhere else. */
#ifndef REFERENCE_H
#define REFERENCE_H
#include "mutate.h"
#include <string.h>

typedef long double Real;

typedef enum {
    FAULT_NONE,
    FAULT_WAY_LEFT_OUT,        /* T takes only the first of its routes into account */
    FAULT_WRONG_G,             /* the slides' slip: the G of the edge before the sampled one */
    FAULT_TABLES,              /* p_d1, p_a1 not normalised again after the cut */
    FAULT_NO_P_D2,             /* p_d2 left out of T */
    FAULT_COPIED_AS_DRAWN,     /* S with q where the mode was copied */
    FAULT_DRAWN_AS_COPIED,     /* S without q where it was drawn */
    FAULT_NO_COSINE,           /* a turned direction's density per solid angle used as one per projected solid angle */
    FAULT_NO_ETA,              /* S> and S< alike at an interface */
    FAULT_NO_NORMALS,          /* S> and S< alike where n_s is not n_g */
    FAULT_LOBE_LOST,           /* a narrow lobe followed by its mirror image, not by the copied place in it */
    FAULTS
} Fault;
static const char *const fault_name[FAULTS] = { "none", "a way left out", "G of the wrong edge", "tables not normalised again", "p_d2 left out",
    "q of a copied mode", "q of a drawn mode left out", "cosine left out", "eta^2 left out", "normals' factor left out",
    "place in a narrow lobe lost" };

/* ---- one vertex ---- */

typedef struct {
    bool passes, specular, narrow;
    Real f[3];                 /* f_s |w_L.n_s|/|w_L.n_g|; L_e at x_0; W_e at x_k */
    Real F;                    /* its largest channel */
    Real p_lens, p_light;      /* per projected solid angle; a specular vertex's without q */
    Real q;                    /* probability of the mode */
} RefScatter;

static inline Real ref_abs(Real a) { return a < 0 ? -a : a; }
/* Relative difference; 0 where both are infinite, as R is for a move without a way back; NaN if either is one. */
static inline double relative(Real a, Real b) { return a == b ? 0 : (double)(ref_abs(a - b) / fmaxl(ref_abs(a), ref_abs(b))); }
static inline Real ref_dot(Vec3 a, Vec3 b) { return (Real)a.x * b.x + (Real)a.y * b.y + (Real)a.z * b.z; }

/* Fresnel's amplitudes, n1 -> n2, cos1 > 0; the reflectance of unpolarised light */
static inline Real ref_fresnel(Real n1, Real n2, Real cos1)
{
    Real sin2 = n1 / n2 * sqrtl(fmaxl(0, 1 - cos1 * cos1));
    if (sin2 >= 1) return 1;
    Real cos2 = sqrtl((1 - sin2) * (1 + sin2));
    Real rs = (n1 * cos1 - n2 * cos2) / (n1 * cos1 + n2 * cos2), rp = (n2 * cos1 - n1 * cos2) / (n2 * cos1 + n1 * cos2);
    return (rs * rs + rp * rp) / 2;
}

/* f_s without any factor of a normal: Lambert and modified Phong */
static inline void ref_f_diffuse(const Surface *s, Vec3 a, Vec3 b, Real f[3])
{
    const Real pi = 3.14159265358979323846264338327950288L;
    Real n = s->material->ns;
    Real cosine = 2 * ref_dot(a, s->ns) * ref_dot(b, s->ns) - ref_dot(a, b);      /* mirror image of a, times b */
    Real lobe = cosine > 0 || n == 0 ? (n + 2) / (2 * pi) * (n == 0 ? (cosine > 0 ? 1 : 0) : powl(cosine, n)) : 0;
    f[0] = s->kd.x / pi + s->material->ks.x * lobe;
    f[1] = s->kd.y / pi + s->material->ks.y * lobe;
    f[2] = s->kd.z / pi + s->material->ks.z * lobe;
}

/* Light goes by a narrow lobe: the Phong part of f_s, with an exponent of 100 or more, is larger than Lambert's. */
static inline bool ref_narrow(const Surface *s, Vec3 a, Vec3 b)
{
    const Material *m = s->material;
    if (material_is_specular(m) || !(m->ns >= 100) || (m->ks.x == 0 && m->ks.y == 0 && m->ks.z == 0)) return false;
    Surface bare = *s;
    Real with[3], diffuse[3];
    Material dull = *m;
    dull.ks = bare.kd = (Rgb){ 0, 0, 0 };
    ref_f_diffuse(&bare, a, b, with);
    bare = *s;
    bare.material = &dull;
    ref_f_diffuse(&bare, a, b, diffuse);
    return fmaxl(with[0], fmaxl(with[1], with[2])) > fmaxl(diffuse[0], fmaxl(diffuse[1], diffuse[2]));
}

static inline RefScatter ref_scatter(const Surface *s, Vec3 wl, Vec3 we, Mode mode, Fault fault)
{
    RefScatter r = { .q = 1, .specular = material_is_specular(s->material) };
    Real lg = ref_dot(wl, s->ng), ls = ref_dot(wl, s->ns), eg = ref_dot(we, s->ng), es = ref_dot(we, s->ns);
    const Material *m = s->material;
    bool same = lg * eg > 0;
    /* a direction lies on the same side of n_s and of n_g; reflection keeps the side, refraction changes it */
    if (!(lg * ls > 0) || !(eg * es > 0) || same != (mode != MODE_REFRACT) || r.specular != (mode != MODE_NONE)) return r;
    if (!r.specular) {
        ref_f_diffuse(s, wl, we, r.f);
        for (int c = 0; c < 3; c++) r.f[c] *= ref_abs(ls) / ref_abs(lg);
        r.narrow = ref_narrow(s, wl, we);
        /* test_bsdf.c checks this density against its sampler */
        r.p_lens = bsdf_pdf_pw(s, wl, we);
        r.p_light = bsdf_pdf_pw(s, we, wl);
    } else {
        Real n_light = lg > 0 ? 1 : m->ni, n_lens = eg > 0 ? 1 : m->ni, eta2 = n_lens * n_lens / (n_light * n_light);
        if (m->kind == MATERIAL_MIRROR) {
            if (mode != MODE_REFLECT) return r;
            r.f[0] = m->ks.x, r.f[1] = m->ks.y, r.f[2] = m->ks.z;
            eta2 = 1;
        } else {
            Real R = ref_fresnel(n_light, lg > 0 ? m->ni : 1, ref_abs(ls));
            r.q = mode == MODE_REFLECT ? R : 1 - R;
            if (mode == MODE_REFLECT) r.f[0] = r.f[1] = r.f[2] = R;
            else r.f[0] = m->tf.x * (1 - R), r.f[1] = m->tf.y * (1 - R), r.f[2] = m->tf.z * (1 - R);
        }
        if (fault == FAULT_NO_ETA) eta2 = 1;
        for (int c = 0; c < 3; c++) r.f[c] *= eta2;
        r.p_light = 1;
        r.p_lens = eta2 * (fault == FAULT_NO_NORMALS ? 1 : ref_abs(lg) * ref_abs(es) / (ref_abs(eg) * ref_abs(ls)));
    }
    r.F = fmaxl(r.f[0], fmaxl(r.f[1], r.f[2]));
    r.passes = r.F > 0;
    return r;
}

/* ---- one path ---- */

typedef struct {
    int k;
    bool passes;
    Real target;               /* f*(x) = w(pixel) luminance(f(x)) */
    Real chi;                  /* f* over the product of all F and G: for the comparison with R's that leave common factors out */
    Real light_pdf_a;
    double raster_x, raster_y;
    struct {
        RefScatter s;
        Real G, inv_d2;        /* of the edge towards the lens; inv_d2 = 1/distance^2 */
        Real cos_lens, cos_light;   /* |w.n_g| towards the next vertex and the one before */
        Vec3 to_lens;
    } v[MAX_EDGES + 1];
} RefPath;

/* Where a direction that leaves the lens meets the film, in pixels: by the point it reaches on the plane in focus, seen from the centre. */
static inline void ref_film(const Camera *camera, Vec3 lens, Vec3 w, double *x, double *y)
{
    double distance = camera->aperture > 0 ? camera->focus : 1;
    Vec3 seen = sub(along(lens, distance / dot(w, camera->forward), w), camera->eye);
    *x = camera->width * (dot(seen, camera->right) / (distance * camera->half_width) + 1) / 2;
    *y = camera->height * (1 - dot(seen, camera->up) / (distance * camera->half_height)) / 2;
}

static inline void ref_path(const Space *space, const Path *x, Fault fault, RefPath *r)
{
    const Scene *scene = space->scene;
    const Camera *camera = &scene->camera;
    int k = r->k = x->k;
    r->passes = true;
    for (int i = 0; i < k; i++) {
        const Point *a = &x->v[i].point, *b = &x->v[i + 1].point;
        Vec3 d = sub(b->p, a->p), w = normalize(d);
        r->v[i].to_lens = w;
        r->v[i].cos_lens = ref_abs(ref_dot(w, a->surface.ng));
        r->v[i + 1].cos_light = ref_abs(ref_dot(w, b->surface.ng));
        r->v[i].inv_d2 = 1 / ref_dot(d, d);
        r->v[i].G = r->v[i].cos_lens * r->v[i + 1].cos_light * r->v[i].inv_d2;
    }
    /* x_0: cosine-distributed emission on the front, 1/pi per projected solid angle; picked in proportion to the power of its triangle */
    const Material *light = x->v[0].point.surface.material;
    Rgb ke = light->ke;
    RefScatter e = { .passes = ref_dot(r->v[0].to_lens, x->v[0].point.surface.ng) > 0 && max3(ke) > 0, .f = { ke.x, ke.y, ke.z }, .F = max3(ke),
                     .p_lens = 1 / (Real)PI, .q = 1 };
    r->v[0].s = e;
    r->light_pdf_a = (Real)max3(ke) / scene->power;             /* test_ratio.c checks 'power' */
    /* x_k: raster positions uniform over the film; the film's area at distance 1 is 4 half_width half_height */
    Vec3 w = neg(r->v[k - 1].to_lens);
    Real c = ref_dot(w, camera->forward), we = 1 / (4 * (Real)camera->half_width * camera->half_height * c * c * c * c);
    ref_film(camera, x->v[k].point.p, w, &r->raster_x, &r->raster_y);
    RefScatter l = { .passes = c > 0, .f = { we, we, we }, .F = we, .p_light = we, .q = 1 };
    r->v[k].s = l;
    for (int i = 1; i < k; i++)
        r->v[i].s = ref_scatter(&x->v[i].point.surface, neg(r->v[i - 1].to_lens), r->v[i].to_lens, x->v[i].mode, fault);
    Real rgb[3] = { 1, 1, 1 }, all = 1;
    for (int i = 0; i <= k; i++) {
        r->passes &= r->v[i].s.passes;
        all *= r->v[i].s.F * (i < k ? r->v[i].G : 1);
        for (int j = 0; j < 3; j++) rgb[j] *= r->v[i].s.f[j] * (i < k ? r->v[i].G : 1);
    }
    Real weight = space->film ? (Real)space->film[(uint32_t)r->raster_y * camera->width + (uint32_t)r->raster_x].weight : 1;
    r->target = weight * (0.2126L * rgb[0] + 0.7152L * rgb[1] + 0.0722L * rgb[2]);
    r->chi = r->passes ? r->target / all : 0;
    if (!r->passes) r->target = 0;
}

static inline bool ref_specular(const RefPath *x, int i) { return i > 0 && i < x->k && x->v[i].s.specular; }
/* densities of the direction that was drawn at x_i, mode included */
static inline Real ref_p_lens(const RefPath *x, int i, Fault fault) { return x->v[i].s.p_lens * (fault == FAULT_DRAWN_AS_COPIED ? 1 : x->v[i].s.q); }
static inline Real ref_p_light(const RefPath *x, int i, Fault fault) { return x->v[i].s.p_light * (fault == FAULT_DRAWN_AS_COPIED ? 1 : x->v[i].s.q); }

/* ---- the bidirectional mutation ---- */

/* the slides' table, cut at k+2 and normalised again */
static inline Real ref_p_d1(int k, int k_d, Fault fault)
{
    Real sum = 0, p = 0;
    for (int e = 1; e <= k + 2; e++) {
        Real one = e == 1 ? 0.25L : e == 2 ? 0.5L : powl(2, -e);
        sum += one;
        if (e == k_d) p = one;
    }
    return fault == FAULT_TABLES ? p : p / sum;
}

static inline Real ref_p_a1(int k, int k_d, int k_a, int max_depth, Fault fault)
{
    Real sum = 0, p = 0;
    for (int e = 1; e <= max_depth + k + 2; e++) {
        int new_k = k - k_d + e, d = e > k_d ? e - k_d : k_d - e;
        if (new_k < 1 || new_k > max_depth) continue;
        Real one = d == 0 ? 0.5L : d == 1 ? 0.15L : 0.1L * powl(2, 1 - d);
        sum += one;
        if (e == k_a) p = one;
    }
    return fault == FAULT_TABLES ? p : p / sum;
}

/* Can m vertices be added between x_s and x_t of z, the path in which they stand, j of them grown from x_s? By the roles in z. */
static inline bool ref_possible(const Path *z, int s, int t, int j)
{
    int m = t - s - 1, k = z->k;
    bool specular_s = s > 0 && s < k && material_is_specular(z->v[s].point.surface.material);
    bool specular_t = t > 0 && t < k && material_is_specular(z->v[t].point.surface.material);
    if (j < 0 || j > m || s >= k) return false;                 /* nothing grows from the lens */
    if (t == k + 1 && j == m) return false;                     /* the lens point itself is grown from the lens */
    if (s == -1 && m == 0) return t < k && max3(z->v[0].point.surface.material->ke) > 0;
    if (j == 0 && specular_s) return false;                     /* a specular vertex cannot be joined */
    if (j == m && specular_t) return false;
    return true;
}

/* Density, per dA of each, of the vertices between x_s and x_t of z grown in way j; 0 if that way would join a specular vertex (a delta of
 * f that no density matches). */
static inline Real ref_way(const RefPath *z, int s, int t, int j, Fault fault)
{
    int e = s + j;                                              /* the joined edge runs from u_j = z_e to z_{e+1} */
    if (ref_specular(z, e) || ref_specular(z, e + 1)) return 0;
    Real p = 1;
    for (int i = s; i < e; i++)                                 /* z_i gives z_{i+1} */
        p *= i < 0 ? z->light_pdf_a : ref_p_lens(z, i, fault) * z->v[fault == FAULT_WRONG_G && i > 0 ? i - 1 : i].G;
    for (int i = e + 2; i <= t; i++)                            /* z_i gives z_{i-1}; the lens point comes with density 1 per dA/A_lens */
        p *= i > z->k ? 1 : ref_p_light(z, i, fault) * z->v[i - 1].G;
    return p;
}

/* sum_j p_a2[j] * density of way j */
static inline Real ref_ways(const Path *path, const RefPath *z, int s, int t, Fault fault)
{
    Real sum = 0;
    int n = 0, m = t - s - 1;
    for (int j = 0; j <= m; j++)
        if (ref_possible(path, s, t, j)) {
            if (n++ == 0 || fault != FAULT_WAY_LEFT_OUT) sum += ref_way(z, s, t, j, fault);
        }
    return n ? sum / n : 0;
}

/* the factors of f that stand between x_s and x_t: F_s G_s .. F_t, as far as there are such vertices */
static inline Real ref_segment(const RefPath *z, int s, int t)
{
    Real f = 1;
    for (int i = s < 0 ? 0 : s; i <= t && i <= z->k; i++) f *= z->v[i].s.F * (i < t && i < z->k ? z->v[i].G : 1);
    return f;
}

/* w[s,t] */
static inline Real ref_w(const Path *path, const RefPath *z, int s, int t)
{
    return ref_ways(path, z, s, t, FAULT_NONE) / ref_segment(z, s, t);
}

static inline Real ref_p_d2(const Tuning *tuning, const Path *path, const RefPath *z, int s, int t)
{
    Real sum = 0, mine = 0;
    int n = 0, k_d = t - s;
    for (int a = -1; a + k_d <= z->k + 1; a++, n++) {
        Real w = ref_w(path, z, a, a + k_d) * (a < 0 ? tuning->light_scale : 1);
        sum += w;
        if (a == s) mine = w;
    }
    Real share = tuning->p_d2_importance;
    return (1 - share) / n + (share > 0 ? share * mine / sum : 0);
}

/* T(y|x) of the move that deletes k_d edges of x from x_s on and adds k_a */
static inline Real ref_T_bidir(const Tuning *tuning, int max_depth, const Path *px, const RefPath *x, const Path *py, const RefPath *y,
                               int s, int k_d, int k_a, Fault fault)
{
    Real p_d2 = fault == FAULT_NO_P_D2 ? 1 : ref_p_d2(tuning, px, x, s, s + k_d);
    return ref_p_d1(x->k, k_d, fault) * p_d2 * ref_p_a1(x->k, k_d, k_a, max_depth, fault) * ref_ways(py, y, s, s + k_a, fault);
}

/* ---- the other mutations ---- */

/* density of r = r2 exp(-ln(r2/r1) u) at a uniform angle, per area of the film (pixels^2) */
static inline Real ref_kernel_film(const Tuning *t, Real r) { return 1 / (2 * (Real)PI * r * r * (-(Real)t->log_r)); }
/* the same for an angle theta to the old direction, per solid angle */
static inline Real ref_kernel_angle(const Tuning *t, Real theta)
{
    return 1 / (2 * (Real)PI * sinl(theta) * theta * (-(Real)t->log_theta));
}
static inline Real ref_angle(Vec3 a, Vec3 b)
{
    Vec3 c = cross(a, b);
    return atan2l(sqrtl(ref_dot(c, c)), ref_dot(a, b));
}

/* Specular, or passed by a narrow lobe */
static inline bool ref_sharp(const Path *x, int i)
{
    if (i <= 0 || i >= x->k) return false;
    Vec3 a = normalize(sub(x->v[i - 1].point.p, x->v[i].point.p)), b = normalize(sub(x->v[i + 1].point.p, x->v[i].point.p));
    return x->v[i].mode != MODE_NONE || ref_narrow(&x->v[i].point.surface, a, b);
}

/* Parsed from the lens, for the row of that name; the first vertex to move, -1 if the suffix is another; S is sharp, but for 'subpath' specular.
 * Skip S*; a D. For 'lens' and 'subpath' its neighbour must not be specular. For 'chain', as long as its neighbour is S, that chain's far end too, and
 * there must be such a chain: L (S+ D)+ S* E has the answer 0, and so has L S+ E if not all of it is specular. */
static inline int ref_lens_suffix(const Path *x, const char *row)
{
    int i = x->k - 1, turned = 0, lobes = 0;
    bool subpath = strcmp(row, "subpath") == 0;
    while (i > 0 && (subpath ? x->v[i].mode != MODE_NONE : ref_sharp(x, i))) lobes += x->v[i--].mode == MODE_NONE;
    if (strcmp(row, "chain") != 0) return i > 0 && (i == 1 || x->v[i - 1].mode == MODE_NONE) ? i : -1;
    while (i > 1 && ref_sharp(x, i - 1)) {
        i--;
        while (i > 0 && ref_sharp(x, i)) i--;
        turned++;
    }
    return turned > 0 || (i == 0 && lobes > 0) ? i : -1;
}

/* (L|D) S* D E: the (L|D), or -1 */
static inline int ref_caustic_suffix(const Path *x)
{
    int i = x->k - 1;
    if (i <= 0 || ref_sharp(x, i)) return -1;
    for (i--; i > 0 && ref_sharp(x, i); i--) {}
    return i;
}

/* Density of y's vertices m .. k-1 as a walk from the lens makes them out of x (same k for the perturbations): the film's density, copied modes
 * at specular vertices, the copied place in the lobe at narrow ones (a rotation: 1 per solid angle), x's directions turned at the others; y_m only receives. *kernels gets the density of the steps, which is the same
 * both ways. 'drawn': a fresh raster position and drawn modes instead. */
static inline Real ref_T_lens(const Space *space, const Tuning *tuning, const RefPath *x, const RefPath *y, int m, bool drawn, Fault fault, Real *kernels)
{
    const Camera *camera = &space->scene->camera;
    Real film = (Real)camera->width * camera->height, p = 1;
    *kernels = 1;
    if (!drawn) {
        Real dx = (Real)x->raster_x - y->raster_x, dy = (Real)x->raster_y - y->raster_y;
        *kernels = ref_kernel_film(tuning, sqrtl(dx * dx + dy * dy)) * film;
    }
    for (int i = y->k; i > m; i--) {                            /* y_i gives y_{i-1} */
        const RefScatter *s = &y->v[i].s;
        if (i == y->k) p *= s->p_light;                         /* 1 over the film's area, as a density per projected solid angle: W_e */
        else if (ref_specular(y, i)) p *= s->p_light * ((drawn && fault != FAULT_DRAWN_AS_COPIED) || fault == FAULT_COPIED_AS_DRAWN ? s->q : 1);
        else {
            if (!s->narrow) *kernels *= ref_kernel_angle(tuning, ref_angle(x->v[i - 1].to_lens, y->v[i - 1].to_lens));
            if (fault != FAULT_NO_COSINE) p /= y->v[i].cos_light;
        }
        p *= y->v[i - 1].G;
    }
    return p;                                                   /* times *kernels */
}

static inline Real ref_T_caustic(const Tuning *tuning, const RefPath *x, const RefPath *y, int m, Fault fault, Real *kernels)
{
    Real p = 1;
    *kernels = ref_kernel_angle(tuning, ref_angle(x->v[m].to_lens, y->v[m].to_lens));
    for (int i = m; i < y->k - 1; i++) {                        /* y_i gives y_{i+1} */
        const RefScatter *s = &y->v[i].s;
        if (ref_specular(y, i)) p *= s->p_lens * (fault == FAULT_COPIED_AS_DRAWN ? s->q : 1);
        else if (fault != FAULT_NO_COSINE) p /= y->v[i].cos_lens;
        p *= y->v[i].G;
    }
    return p;
}
#endif
