/* The last steps of reading a mesh, once all of a file is known. Knows nothing of files. */
#ifndef MESH_H
#define MESH_H
#include "scene.h"

typedef struct { uint32_t first, corners; } MeshPolygon;           /* its corners - 2 triangles are a fan, from 'first' on */

/* Takes a mesh whose triangles index 'position' (m->n_positions of them, user unit, malloced; no longer the caller's) in range, whose polygons are
 * fans, and whose normals and uvs are NAN and their indices out of range where they are missing. Fills centre, unit and position, cuts the
 * polygons better, drops unused positions and normals and triangles without area, and makes the winding agree with the normals.
 * triangle_material moves along, whatever it holds. Returns what is wrong, or NULL. */
const char *mesh_finish(Mesh *m, double (*position)[3], const MeshPolygon *polygon, uint32_t n_polygons);

/* Keeps texture coordinates only where there is a texture and all three corners have them. False if memory runs out. */
bool mesh_finish_uvs(Mesh *m);

/* Gives back what the growth of an array, or of all of the mesh, has reserved; keeps an array if that fails. */
void *mesh_shrunk(void *array, size_t bytes);
void mesh_trim(Mesh *m);

static inline void mesh_set3(uint32_t target[3], uint32_t a, uint32_t b, uint32_t c)
{
    target[0] = a;
    target[1] = b;
    target[2] = c;
}
#endif
