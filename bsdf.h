/* Materials and scattering at one surface point: sample, evaluate, density; Lambert, normalised Phong, mirror, exact-Fresnel dielectric.
 *
 * Directions are unit vectors that point away from the surface. w_light leads towards the light end of a path, w_lens towards the lens end.
 * Shading normals (n_s) bend the lobes; the geometric normal (n_g) measures. A direction counts only if it lies on the same side of both.
 * Knows no paths and no scene. [lecture: Adding Vertices; Sampling wrt BSDF; Precomputation] */
#ifndef BSDF_H
#define BSDF_H
#include "image.h"
#include "rng.h"
#include "vec.h"

typedef enum { MATERIAL_DIFFUSE, MATERIAL_MIRROR, MATERIAL_GLASS } MaterialKind;

/* Where a texture lies: it is looked up at scale * uv + offset. */
typedef struct {
    double scale[2], offset[2];
    bool clamp;                /* beyond its border goes on as the border is; else it is repeated */
} MapPlace;

typedef struct {
    char *name;                /* owned */
    MaterialKind kind;
    Rgb kd;                    /* diffuse reflectance (DIFFUSE) */
    Rgb ks;                    /* Phong reflectance (DIFFUSE), tint (MIRROR); kd + ks <= 1 in each channel */
    Rgb tf;                    /* transmission tint (GLASS) */
    Rgb ke;                    /* emitted radiance on the front side, any kind */
    double ns;                 /* Phong exponent, >= 0 */
    double ni;                 /* refractive index behind the front side over the one before it, > 0 */
    Image *map_kd;             /* replaces kd; NULL if absent; owned by the mesh */
    MapPlace map_place;
} Material;

/* How light passes a specular vertex; MODE_NONE for every other. */
typedef enum { MODE_NONE, MODE_REFLECT, MODE_REFRACT } Mode;

/* A point of a surface with all that scattering needs. */
typedef struct {
    const Material *material;
    Rgb kd;                    /* diffuse reflectance here, texture applied */
    Vec3 ng, ns;               /* unit; ng on the front side */
} Surface;

static inline bool material_is_specular(const Material *m) { return m->kind != MATERIAL_DIFFUSE; }
/* Its Phong lobe is so narrow that two points seldom lie in it by chance: half of it within 0.12 radians of the mirror image, or less. */
static inline bool material_is_narrow(const Material *m) { return m->kind == MATERIAL_DIFFUSE && m->ns >= 100 && max3(m->ks) > 0; }
static inline bool material_emits(const Material *m) { return max3(m->ke) > 0; }

/* Scattering from w_light to w_lens, as ratios that stay of order one. F is the largest channel of f_s |w_light.n_s|/|w_light.n_g|.
 * 1/S> = p>/F belongs to a vertex from which the next one towards the lens was sampled, 1/S< = p</F the same towards the light;
 * p per projected solid angle (n_g), the mixture over all lobes. Inverses, so that what cannot be sampled is 0.
 * At a specular vertex inv_F is 0 (it cannot be joined), and S carries reflectance over q for a mode that was drawn with probability q;
 * for a mode copied from another path q counts as 1: 1/S_copied = (1/S) / q. */
typedef struct {
    Rgb colour;                /* f_s / F, each channel in [0,1] */
    double inv_F, inv_S_lens, inv_S_light;
    double q;                  /* 1 where nothing was drawn */
    bool narrow;               /* most of F is that of a narrow lobe */
} Scatter;

/* Emission of a lamp's surface, F = L_e, for a direction towards the lens drawn by the cosine law: its 1/S> is 1 / (pi F). */
static inline Scatter bsdf_emission(const Material *m)
{
    double emitted = max3(m->ke);
    return (Scatter){ scale(1 / emitted, m->ke), 1 / emitted, 1 / (PI * emitted), 0, 1, false };
}

/* False if nothing is scattered (black, or a direction on the wrong side; for MODE_REFLECT and MODE_REFRACT also if the sides or the material
 * do not fit the mode). For a specular vertex the directions are taken to obey the law of the mode; only their cosines enter. */
bool bsdf_scatter(const Surface *surface, Vec3 w_light, Vec3 w_lens, Mode mode, Scatter *out);

/* Draws the other direction from the known one, and the mode at a specular vertex. False if the sample is lost below the surface.
 * The density is the p of bsdf_scatter; it does not depend on which end of the path the known direction leads to. */
bool bsdf_sample(const Surface *surface, Vec3 known, Rng *rng, Vec3 *w, Mode *mode);
/* The same from a point of the unit disk, uniform if the direction is to be; at a diffuse surface it alone says where in the lobe w lies. */
bool bsdf_sample_at(const Surface *surface, Vec3 known, const double disk[2], Rng *rng, Vec3 *w, Mode *mode);

/* The other direction at a specular vertex for a given mode. False where the mode does not exist: no refraction at a mirror or under total
 * reflection, no specular mode at all at a diffuse surface. */
bool bsdf_follow(const Surface *surface, Vec3 known, Mode mode, Vec3 *w);

static inline Vec3 bsdf_mirrored(const Surface *surface, Vec3 known) { return along(neg(known), 2 * dot(known, surface->ns), surface->ns); }

/* How light passes a vertex whose direction is not drawn but copied from another: by its mode; or, MODE_NONE, by a narrow lobe, as far off the mirror
 * image, and on the side of it, as w is there: by the least rotation that takes the one mirror image to the other. */
typedef struct { Mode mode; Vec3 mirrored, w; } Passage;
static inline Passage bsdf_passage(const Surface *surface, Vec3 known, Vec3 w, Mode mode) { return (Passage){ mode, bsdf_mirrored(surface, known), w }; }

/* The other direction, copied. False where it cannot be: as bsdf_follow, or the surface has no narrow lobe. */
bool bsdf_pass(const Surface *surface, Vec3 known, const Passage *passage, Vec3 *w);

/* By how much that direction changes, to first order, if the known one changes by d_known and the shading normal by d_ns. */
Vec3 bsdf_pass_change(const Surface *surface, Vec3 known, const Passage *passage, Vec3 d_known, Vec3 d_ns);

/* p of bsdf_sample per projected solid angle (n_g) for a non-specular surface; 0 on the wrong side. */
double bsdf_pdf_pw(const Surface *surface, Vec3 known, Vec3 w);

/* Fresnel reflectance of unpolarised light at a smooth dielectric; cos_i > 0 on the incident side, eta = index beyond / index before.
 * *cos_t receives the cosine on the other side, 0 under total reflection. */
double bsdf_fresnel(double cos_i, double eta, double *cos_t);

/* The largest channel of all that the surface can reflect, transmit: a bound of albedo for Russian roulette, in [0,1]. */
double bsdf_albedo(const Surface *surface);

/* cosine-distributed direction about unit n, density cos/pi per solid angle */
Vec3 sample_cosine(Vec3 n, Rng *rng);
/* unit w turned by the angle of this cosine and sine, towards a uniform azimuth */
Vec3 sample_turned(Vec3 w, double cosine, double sine, Rng *rng);
#endif
