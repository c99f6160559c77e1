/* The scene: mesh, materials, lights, camera, and ray queries between surface points.
 *
 * Read-only after loading; obj.c fills the mesh and the materials, scene.c the rest. Knows nothing of paths or sampling strategies.
 *
 * Unit: everything inside the program is in the scene's own unit: user position = centre + unit * position, where the centre is that of
 * the mesh's bounding box and unit is the power of two that brings the largest half extent into (1/2, 1]. Floating-point behaviour then does
 * not depend on the user's unit or origin, and scaling a scene by a power of two gives the same file bit for bit. Radiance has no length in it. */
#ifndef SCENE_H
#define SCENE_H
#include "bsdf.h"
#include "bvh.h"
#include "image.h"

/* The front of a triangle is the side from which its vertices run counter-clockwise; the reader has already swapped vertices where the
 * vertex normals say otherwise. Triangles of zero area are not kept. */
typedef struct {
    uint32_t n_triangles, n_positions, n_normals, n_uvs, n_materials, n_textures;
    float (*position)[3];              /* [n_positions], scene unit */
    float (*normal)[3];                /* [n_normals], unit length; NULL if no face has normals */
    float (*uv)[2];                    /* [n_uvs]; NULL if no textured face has them */
    uint32_t (*triangle)[3];           /* [n_triangles], indices into position */
    uint32_t (*triangle_normal)[3];    /* [n_triangles], indices into normal, BVH_NONE in [0] where a face has none; NULL if no face has */
    uint32_t (*triangle_uv)[3];        /* the same for uv */
    uint32_t *triangle_material;       /* [n_triangles], indices into material */
    Material *material;                /* [n_materials]; only those that a face names, plus the grey default where a face has none */
    Image **texture;                   /* [n_textures], owned; a material points to one of them or to none */
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

/* The camera in the scene's unit. Pinhole if aperture is 0. */
typedef struct {
    Vec3 eye, right, up, forward;      /* orthonormal; x runs right, y down on the film */
    double half_width, half_height;    /* of the film at distance 1 */
    double aperture, focus;
    uint32_t width, height;
} Camera;

/* A point of a surface, or of the lens (triangle = BVH_NONE, ng = forward, material NULL). */
typedef struct {
    Vec3 p;
    uint32_t triangle;
    Surface surface;
} Point;

typedef struct LampTree LampTree;

typedef struct {
    Mesh mesh;
    Bvh *bvh;
    Camera camera;
    uint32_t n_lights;
    uint32_t *light;                   /* [n_lights] emitting triangles */
    double *light_threshold;           /* [n_lights] alias table: keep i below the threshold, else take light_alias[i] */
    uint32_t *light_alias;
    LampTree *lamp_tree;               /* NULL where it does not pay */
    double power;                      /* sum over emitters of max(ke) * area: light sampling is in proportion to it */
    bool has_specular, has_narrow;     /* of its materials: material_is_specular, material_is_narrow */
    double seconds_load, seconds_build;
    uint64_t *rays;                    /* [1] closest and any hit queries so far */
} Scene;

/* Reads OBJ, MTL and NAME.cam; 'overrides' wins over NAME.cam. False with an error. Free with scene_free. */
bool scene_load(Scene *scene, const char *path, const CameraSettings *overrides, BvhEffort effort, Report *report);
void scene_free(Scene *scene);
size_t scene_bytes(const Scene *scene);

/* First surface met from a point in the unit direction w. The ray starts off the surface by a bound of the rounding errors, on the side of w,
 * and never meets the triangle it starts on; the hit is computed anew in double, on the line through the point itself. */
bool scene_trace(const Scene *scene, const Point *from, Vec3 w, Point *hit);

/* By how much the shading normal changes, to first order, if the point moves by d_p in the plane of its triangle. */
Vec3 scene_normal_change(const Scene *scene, const Point *at, Vec3 d_p);

/* V(a,b): whether nothing lies between; both ends treated alike. */
bool scene_visible(const Scene *scene, const Point *a, const Point *b);

/* Uniform on an emitting triangle that is picked in proportion to its power, for u uniform in [0,1)^3. Needs n_lights > 0. */
void scene_sample_light(const Scene *scene, const double u[3], Point *point);
/* p_A of scene_sample_light for any point of an emitting surface, also one that was hit by chance (per area, scene unit). */
double scene_light_pdf_a(const Scene *scene, const Material *material);
/* The same for light that is to arrive at a point, on the side of w: rather from lamps that are near and face it. Returns the density over p_A above, 0 if
 * there is no such lamp; 'preference' tells it for a given point of a lamp, on whose side light then arrives. Both 1 where lamps hardly differ. */
double scene_pick_light(const Scene *scene, const Point *at, Vec3 w, const double u[3], Point *point);
double scene_light_preference(const Scene *scene, const Point *at, const Point *light);

/* Of a triangle (a,b,c): its area, and the point (1-u-v) a + u b + v c, with the normal that it has there. */
double scene_triangle_area(const Scene *scene, uint32_t triangle);
void scene_triangle_point(const Scene *scene, uint32_t triangle, double u, double v, Point *point);

/* lamps.c, for scene.c: fills n_lights and what follows it, once the mesh is there (false if memory runs out); drops the tree if it would not
 * pay, once everything else is there; frees; counts. */
bool lamps_build(Scene *scene);
void lamps_settle(Scene *scene);
void lamps_free(Scene *scene);
size_t lamps_bytes(const Scene *scene);

/* A point of the lens, uniform. */
void camera_sample_lens(const Camera *camera, Rng *rng, Point *lens);
/* The same for a given point of the unit disk. */
void camera_lens_at(const Camera *camera, const double disk[2], Point *lens);
/* The direction in which the lens point sees the raster position (pixels, (0,0) top left). */
Vec3 camera_direction(const Camera *camera, const Point *lens, double x, double y);
/* The raster position of a direction that leaves the lens point, and W_e per projected solid angle (mathematics: 1/(A_film cos^4)).
 * False if it is off the film or behind. */
bool camera_project(const Camera *camera, const Point *lens, Vec3 w, double *x, double *y, double *we);
#endif
