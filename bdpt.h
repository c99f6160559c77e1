/* Independent samples of path space by a bidirectional path tracer, all techniques under multiple importance sampling.
 * A reference for the pictures, and the generator of seeds and of b. Knows no mutations. */
#ifndef BDPT_H
#define BDPT_H
#include "tracer.h"

/* What light does on its way, by the specular vertices: caustics have one next to the light, and seen ones also one next to the lens. */
typedef enum { CLASS_DIRECT, CLASS_DIFFUSE, CLASS_CAUSTIC, CLASS_CAUSTIC_SEEN, CLASS_SPECULAR, CLASSES } PathClass;
extern const char *const path_class_name[CLASSES];

typedef struct Bdpt Bdpt;      /* work space for two subpaths */
Bdpt *bdpt_new(void);          /* NULL if memory runs out */
void bdpt_free(Bdpt *bdpt);

/* What a lens subpath does at glass that the lens sees: it draws a way, and a candidate counts path_bidirectional_value but for the chance of that; or it
 * goes both ways, the rarer one by roulette, and no candidate counts more than that value. */
typedef enum { ONE_WAY, BOTH_WAYS } FirstGlass;

/* Traces one pair of subpaths, the lens one through raster position (x, y), and hands every candidate that carries light to 'visit'.
 * Of 'numbers', if not NULL, the lens's point is taken, and the direction in which the lens subpath's first vertex scatters that is not specular. Of the REST it leaves out what is REACH_UNJOINED: the chains have seeds of those from elsewhere (run_meet).
 * With (x, y) uniform over the film, the expectation of the sum of rgb over candidates in pixel j, times the number of pixels, is pixel j. */
void bdpt_sample(Bdpt *bdpt, const Space *space, double x, double y, FirstGlass glass, const Numbers *numbers, Rng *rng, void (*visit)(void *context, const Candidate *), void *context);

/* Of the candidate that is being visited. */
PathClass bdpt_class(const Bdpt *bdpt, const Candidate *candidate);

/* Of the candidate that is being visited, if no walk was bent for it: path_bidirectional_value. Its rgb is at most that. */
double bdpt_value(const Bdpt *bdpt, const Candidate *candidate);

/* Of the candidate that is being visited: whether a walk could have been bent to make its path (bend.h). */
bool bdpt_may_be_bent(const Bdpt *bdpt, const Candidate *candidate);

/* The candidate's whole path, evaluated; to be asked for while it is being visited, or of the last sample, if it went ONE_WAY. */
bool bdpt_path(const Bdpt *bdpt, const Space *space, int n_light, int n_lens, Path *out);
#endif
