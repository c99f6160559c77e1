/* Independent samples of path space: a path tracer, and a bidirectional path tracer with all techniques under multiple importance sampling.
 * References for the pictures, and the generator of seeds and of b. Knows no mutations. */
#ifndef BDPT_H
#define BDPT_H
#include "path.h"

/* One path that a bidirectional sample found, by joining n_light vertices grown from the light to n_lens grown from the lens
 * (n_light >= 0, n_lens >= 1, k = n_light + n_lens - 1 edges). */
typedef struct {
    int n_light, n_lens;
    uint32_t pixel;
    Rgb rgb;                   /* f / sum of the densities of all techniques (balance heuristic) */
    double weight;             /* the same of the target f*: luminance times w(pixel), times the share of f that the space holds */
    double traced;             /* path_traced_value of the path */
    bool direct;               /* path_is_direct */
} Candidate;

/* What light does on its way, by the specular vertices: caustics have one next to the light, and seen ones also one next to the lens. */
typedef enum { CLASS_DIRECT, CLASS_DIFFUSE, CLASS_CAUSTIC, CLASS_CAUSTIC_SEEN, CLASS_SPECULAR, CLASSES } PathClass;
extern const char *const path_class_name[CLASSES];

typedef struct Bdpt Bdpt;      /* work space for two subpaths */
Bdpt *bdpt_new(void);          /* NULL if memory runs out */
void bdpt_free(Bdpt *bdpt);

/* Traces one pair of subpaths, the lens one through raster position (x, y), and hands every candidate that carries light to 'visit'.
 * With (x, y) uniform over the film, the expectation of the sum of rgb over candidates in pixel j, times the number of pixels, is pixel j. */
void bdpt_sample(Bdpt *bdpt, const Space *space, double x, double y, Rng *rng, void (*visit)(void *context, const Candidate *), void *context);

/* Of a candidate of bdpt_sample; valid until the next one. */
PathClass bdpt_class(const Bdpt *bdpt, const Candidate *candidate);

/* The candidate's whole path, evaluated; valid until the next bdpt_sample. */
bool bdpt_path(const Bdpt *bdpt, const Space *space, int n_light, int n_lens, Path *out);

/* Unidirectional: radiance seen at a raster position, light sampling and scattering joined by multiple importance sampling.
 * The first light sample is taken at light[0..2] in [0,1), so that the caller can stratify it like (x, y).
 * 'visit' may be NULL, or sees each path found: pixel, rgb (whole, whatever its share), traced, direct. */
Rgb path_trace(const Space *space, double x, double y, const double light[3], Rng *rng, void (*visit)(void *context, const Candidate *), void *context);
#endif
