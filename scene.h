/* The scene: mesh, materials, lights, camera, and ray queries between surface points.
 *
 * Read-only after loading; obj.c fills the mesh and the materials, scene.c the rest. Knows nothing of paths or sampling strategies.
 *
 * Unit: everything inside the program is in the scene's own unit: user position = centre + unit * position, where the centre is that of
 * the mesh's bounding box and unit is the power of two that brings the largest half extent into (1/2, 1]. Floating-point behaviour then does
 * not depend on the user's unit or origin, and scaling a scene by a power of two gives the same file bit for bit. Radiance has no length in it. */
#ifndef SCENE_H
#define SCENE_H
#include "bvh.h"
#include "image.h"
#include "rng.h"

typedef enum { MATERIAL_DIFFUSE, MATERIAL_MIRROR, MATERIAL_GLASS } MaterialKind;

typedef struct {
    char *name;                /* owned */
    MaterialKind kind;
    Rgb kd;                    /* diffuse reflectance (DIFFUSE) */
    Rgb ks;                    /* Phong reflectance (DIFFUSE), tint (MIRROR); kd + ks <= 1 in each channel */
    Rgb tf;                    /* transmission tint (GLASS) */
    Rgb ke;                    /* emitted radiance on the front side, any kind */
    double ns;                 /* Phong exponent, >= 0 */
    double ni;                 /* refractive index behind the front side over the one before it, > 0 */
    Image *map_kd;             /* replaces kd; NULL if absent; owned */
} Material;

/* The front of a triangle is the side from which its vertices run counter-clockwise; the reader has already swapped vertices where the
 * vertex normals say otherwise. Triangles of zero area are not kept. */
typedef struct {
    uint32_t n_triangles, n_positions, n_normals, n_uvs, n_materials;
    float (*position)[3];              /* [n_positions], scene unit */
    float (*normal)[3];                /* [n_normals], unit length; NULL if no face has normals */
    float (*uv)[2];                    /* [n_uvs]; NULL if no textured face has them */
    uint32_t (*triangle)[3];           /* [n_triangles], indices into position */
    uint32_t (*triangle_normal)[3];    /* [n_triangles], indices into normal, BVH_NONE in [0] where a face has none; NULL if no face has */
    uint32_t (*triangle_uv)[3];        /* the same for uv */
    uint32_t *triangle_material;       /* [n_triangles], indices into material */
    Material *material;                /* [n_materials]; only those that a face names, plus the grey default where a face has none */
    Vec3 centre;                       /* user unit */
    double unit;                       /* a power of two */
} Mesh;

/* What SCENE.cam or the command line says, in the user's unit. A field counts only if its flag is set. */
typedef struct {
    bool has_eye, has_look, has_up, has_fov, has_size, has_aperture, has_focus;
    Vec3 eye, look, up;
    double fov;                        /* full vertical angle in degrees */
    uint32_t width, height;            /* film, pixels */
    double aperture;                   /* lens radius; 0 = pinhole */
    double focus;                      /* distance of the plane in focus along the view direction */
} CameraSettings;
#endif
