/* The reader of Wavefront OBJ and MTL files, and of SCENE.cam. Fills a Mesh; knows no lights, no tree, no camera frame. */
#ifndef OBJ_H
#define OBJ_H
#include "scene.h"

/* Reads an OBJ file with its materials and textures. False with an error 'FILE:LINE: reason'; nothing is kept then. Free with mesh_free. */
bool obj_read(Mesh *mesh, const char *path, Report *report);
void mesh_free(Mesh *mesh);

/* Reads SCENE.cam: 'eye X Y Z', 'look X Y Z', 'up X Y Z', 'fov DEG', 'size W H', 'aperture R', 'focus D', '# comment'.
 * A file that does not exist is no error and sets nothing. */
bool cam_read(CameraSettings *settings, const char *path, Report *report);

/* The number at text[0..n-1], all of it: correctly rounded, independent of the locale. False if it is not a decimal number or not finite.
 * Also used for the command line. */
bool parse_double(const char *text, size_t n, double *value);
#endif
