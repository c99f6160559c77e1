/* Independent samples of path space by a path tracer. A reference for pictures, and what a run gives all to that it does well. Knows no mutations. */
#ifndef TRACER_H
#define TRACER_H
#include "path.h"

/* Radiance seen at a raster position, light sampling and scattering joined by multiple importance sampling; of the part of f that the space
 * holds. The first light sample is taken at light[0..2] in [0,1), so that the caller can stratify it like (x, y).
 * 'visit' may be NULL, or sees each path found, n_light of its vertices (0 or 1) sampled on a light; all of it but 'weight' is set. 'trail' is work
 * space; it holds the n_lens vertices of the path that is being visited. */
Rgb path_trace(const Space *space, double x, double y, const double light[3], Rng *rng, Path *trail,
               void (*visit)(void *context, const Candidate *), void *context);

/* The path of n_lens vertices that is being visited, which met a light by itself, evaluated; false if it carries nothing. */
bool path_trailed(const Space *space, const Path *trail, int n_lens, Path *out);
#endif
