/* Cuts a polygon of a mesh file into triangles. Knows positions only. */
#ifndef POLYGON_H
#define POLYGON_H
#include <stdbool.h>
#include <stdint.h>

/* The polygon's corners are corner[0..n-1], indices into position, n >= 3. Writes n-2 triangles of corner numbers, wound as the polygon is.
 * A simple polygon, convex or not, is covered exactly once; one that crosses itself gets n-2 triangles of some kind. Time is bounded by
 * about n sqrt(n) for what is met in files and by 1000 n at worst, where ears are then cut unseen. False only if memory runs out. */
bool polygon_triangulate(const float (*position)[3], const uint32_t *corner, uint32_t n, uint32_t (*triangle)[3]);
#endif
