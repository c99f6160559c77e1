/* Independent samples of path space by a path tracer. A reference for pictures, and what a run gives all to that it does well. Knows no mutations. */
#ifndef TRACER_H
#define TRACER_H
#include "path.h"

/* What a sample is made of but for what comes late on its way: numbers in [0,1) that a caller can let fill their ranges evenly from sample to sample. */
typedef struct {
    double film[2];                /* where in the pixel */
    double light[3];               /* the first light sample */
    double scatter[2];             /* the direction in which the first non-specular vertex scatters */
    double lens[2];
} Numbers;
enum { NUMBERS = sizeof(Numbers) / sizeof(double) };

/* All of them at random. */
Numbers numbers_random(Rng *rng);

/* Radiance seen in a pixel (column, row), light sampling and scattering joined by multiple importance sampling; of the part of f that the space holds.
 * 'visit' may be NULL, or sees each path found, n_light of its vertices (0 or 1) sampled on a light; all of it but 'weight' is set. 'trail' is work
 * space; it holds the n_lens vertices of the path that is being visited. */
Rgb path_trace(const Space *space, uint32_t column, uint32_t row, const Numbers *numbers, Rng *rng, Path *trail,
               void (*visit)(void *context, const Candidate *), void *context);

/* The path of n_lens vertices that is being visited, which met a light by itself, evaluated; false if it carries nothing. */
bool path_trailed(const Space *space, const Path *trail, int n_lens, Path *out);
#endif
