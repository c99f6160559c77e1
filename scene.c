/* Lights, camera, and ray queries between surface points. See scene.h for units and contracts. */
#include "scene.h"
#include "obj.h"
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void corners(const Mesh *m, uint32_t triangle, Vec3 out[3])
{
    for (int i = 0; i < 3; i++) out[i] = from_float(m->position[m->triangle[triangle][i]]);
}

/* A bound of what single precision loses at this place in the tree's unit: the origin's rounding (2^-24 of each coordinate) and the like in the
 * tree's own arithmetic, eightfold. Nearer surfaces than this cannot be told apart. */
static double rounding(Vec3 p) { return 0x1p-21 * larger(larger(fabs(p.x), fabs(p.y)), larger(fabs(p.z), 0x1p-6)); }

static bool set_camera(Scene *s, const CameraSettings *c, const char *path, Report *report)
{
    const Mesh *m = &s->mesh;
    Vec3 low = vec3(INFINITY, INFINITY, INFINITY), high = neg(low);
    for (uint32_t i = 0; i < m->n_triangles; i++) {
        Vec3 p[3];
        corners(m, i, p);
        for (int j = 0; j < 3; j++) {
            low = vec3(fmin(low.x, p[j].x), fmin(low.y, p[j].y), fmin(low.z, p[j].z));
            high = vec3(fmax(high.x, p[j].x), fmax(high.y, p[j].y), fmax(high.z, p[j].z));
        }
    }
    Camera *camera = &s->camera;
    double inv_unit = 1 / m->unit, tangent = tan((c->has_fov ? c->fov : 40) * PI / 360);
    camera->width = c->has_size ? c->width : 512;
    camera->height = c->has_size ? c->height : 512;
    camera->half_height = tangent;
    camera->half_width = tangent * camera->width / camera->height;
    Vec3 centre = scale(0.5, add(low, high));
    Vec3 look = c->has_look ? scale(inv_unit, sub(c->look, m->centre)) : centre;
    double radius = 0.5 * length(sub(high, low)), tightest = fmin(camera->half_height, camera->half_width);
    /* unframed scenes are seen from the front and slightly above, the bounding sphere filling the film */
    Vec3 direction = normalize(vec3(0, 0.25, 1));
    camera->eye = c->has_eye ? scale(inv_unit, sub(c->eye, m->centre)) : along(look, 1.02 * radius * sqrt(1 + 1 / (tightest * tightest)), direction);
    Vec3 view = sub(look, camera->eye), up = c->has_up ? c->up : vec3(0, 1, 0);
    if (!finite3(view) || !(dot(view, view) > 0)) return report_error(report, path, 0, "the camera's eye and look are the same point");
    camera->forward = normalize(view);
    Vec3 right = cross(camera->forward, scale(1 / fmax(max3(vec3(fabs(up.x), fabs(up.y), fabs(up.z))), 1e-300), up));
    if (!(dot(right, right) > 1e-20)) {            /* up along the view: any up will do, but say so if it was asked for */
        if (c->has_up) report_warning(report, path, 0, "the camera's up lies along its view; another is used");
        Vec3 other;
        frame(camera->forward, &right, &other);
    }
    camera->right = normalize(right);
    camera->up = cross(camera->right, camera->forward);
    camera->aperture = c->has_aperture ? c->aperture * inv_unit : 0;
    camera->focus = c->has_focus ? c->focus * inv_unit : length(view);
    return true;
}

/* ---- things in one place ---- */

static Vec3 normal_of(const Mesh *m, uint32_t triangle)
{
    Vec3 c[3];
    corners(m, triangle, c);
    return normalize(cross(sub(c[1], c[0]), sub(c[2], c[0])));
}

/* A surface other than 'skip' so close to p, along the line in direction w, that rays cannot tell which comes first; BVH_NONE if there is none. */
static uint32_t touching(const Scene *s, Vec3 p, Vec3 w, uint32_t skip)
{
    double reach = 2 * rounding(p);
    Ray ray = { along(p, -reach, w), w, 2 * reach, { skip, BVH_NONE } };
    Hit hit;
    return bvh_closest(s->bvh, &ray, &hit) ? hit.triangle : BVH_NONE;
}

/* Whether a lamp has to be lifted: something touches its middle or a place near a corner. Of two lamps that face one way it is the later. One so
 * small that its own neighbours are that near stays. */
static bool covers(const Scene *s, uint32_t lamp)
{
    static const double place[4][3] = { { 4, 4, 4 }, { 10, 1, 1 }, { 1, 10, 1 }, { 1, 1, 10 } };     /* barycentric, in twelfths */
    const Mesh *m = &s->mesh;
    Vec3 c[3], ng = normal_of(m, lamp);
    corners(m, lamp, c);
    Vec3 e1 = sub(c[1], c[0]), e2 = sub(c[2], c[0]);
    if (length(cross(e1, e2)) < 64 * rounding(c[0]) * larger(length(e1), larger(length(e2), length(sub(e2, e1))))) return false;
    for (int i = 0; i < 4; i++) {
        Vec3 p = scale(1.0 / 12, along(along(scale(place[i][0], c[0]), place[i][1], c[1]), place[i][2], c[2]));
        uint32_t other = touching(s, p, ng, lamp);
        if (other == BVH_NONE) continue;
        if (other < lamp || !material_emits(&m->material[m->triangle_material[other]]) || dot(normal_of(m, other), ng) < 0) return true;
    }
    return false;
}

/* A lamp in the very place of another face, as in the plane of a ceiling or where two back to back shine to both sides, would be hidden by it
 * from some rays and not from others, and a point sampled on it would be visible where no ray can find it: it is lifted to the side that
 * shines. Its triangle gets corners of its own. *lifted says whether there was one; false if memory runs out. */
static bool lift_lamps(Scene *s, bool *lifted)
{
    Mesh *m = &s->mesh;
    uint32_t n = 0;
    for (uint32_t i = 0; i < s->n_lights; i++) n += covers(s, s->light[i]);
    *lifted = n > 0;
    if (n == 0) return true;
    if (n > (BVH_NONE - m->n_positions) / 3) return false;
    float (*position)[3] = realloc(m->position, ((size_t)m->n_positions + 3 * (size_t)n) * sizeof *position);
    if (!position) return false;
    m->position = position;
    for (uint32_t i = 0; i < s->n_lights; i++) {       /* touches positions that the tree's copy keeps: every lamp is judged by the old places */
        uint32_t lamp = s->light[i];
        if (!covers(s, lamp)) continue;
        Vec3 c[3], ng = normal_of(m, lamp);
        corners(m, lamp, c);
        for (int k = 0; k < 3; k++) {
            Vec3 p = along(c[k], 4 * rounding(c[k]), ng);
            float *to = m->position[m->n_positions];
            to[0] = (float)p.x; to[1] = (float)p.y; to[2] = (float)p.z;
            m->triangle[lamp][k] = m->n_positions++;
        }
    }
    return true;
}

/* An eye on a surface would see what is on either side of it as rounding has it, each ray for itself: it moves to the side it looks to. */
static void lift_eye(Scene *s)
{
    static const Vec3 axis[3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };      /* no surface is far along all three */
    Camera *camera = &s->camera;
    for (int i = 0; i < 12; i++) {                                              /* a corner has more than one */
        uint32_t triangle = touching(s, camera->eye, axis[i % 3], BVH_NONE);
        if (triangle == BVH_NONE) continue;
        Vec3 ng = normal_of(&s->mesh, triangle);
        camera->eye = along(camera->eye, copysign(4 * rounding(camera->eye), dot(camera->forward, ng)), ng);
    }
}

static bool build_tree(Scene *s, BvhEffort effort)
{
    bvh_free(s->bvh);
    s->bvh = bvh_new((const float (*)[3])s->mesh.position, (const uint32_t (*)[3])s->mesh.triangle, s->mesh.n_triangles, effort);
    return s->bvh != NULL;
}

/* Lights, the tree, and nothing that rays cannot tell apart; lamps in one place with each other may take some rounds. */
static bool build(Scene *s, BvhEffort effort)
{
    bool again = true;
    if (!lamps_build(s) || !build_tree(s, effort)) return false;
    for (int round = 0; again && round < 8; round++)
        if (!lift_lamps(s, &again) || (again && !build_tree(s, effort))) return false;
    lift_eye(s);
    lamps_settle(s);
    return true;
}

static void override(CameraSettings *c, const CameraSettings *o)
{
    if (o->has_eye) { c->has_eye = true; c->eye = o->eye; }
    if (o->has_look) { c->has_look = true; c->look = o->look; }
    if (o->has_up) { c->has_up = true; c->up = o->up; }
    if (o->has_fov) { c->has_fov = true; c->fov = o->fov; }
    if (o->has_size) { c->has_size = true; c->width = o->width; c->height = o->height; }
    if (o->has_aperture) { c->has_aperture = true; c->aperture = o->aperture; }
    if (o->has_focus) { c->has_focus = true; c->focus = o->focus; }
}

/* NAME.cam beside NAME.obj */
static bool read_camera(CameraSettings *settings, const char *path, Report *report)
{
    size_t n = strlen(path);
    const char *dot = strrchr(path, '.'), *slash = strrchr(path, '/');
    if (dot && (!slash || dot > slash)) n = (size_t)(dot - path);
    char *name = malloc(n + 5);
    if (!name) return report_error(report, path, 0, "out of memory");
    memcpy(name, path, n);
    memcpy(name + n, ".cam", 5);
    bool ok = cam_read(settings, name, report);
    free(name);
    return ok;
}

bool scene_load(Scene *s, const char *path, const CameraSettings *overrides, BvhEffort effort, Report *report)
{
    double start = now();
    CameraSettings settings = { 0 };
    *s = (Scene){ .rays = calloc(1, sizeof *s->rays) };
    if (!s->rays) return report_error(report, path, 0, "out of memory");
    if (!obj_read(&s->mesh, path, report)) { free(s->rays); return false; }
    if (!read_camera(&settings, path, report)) { scene_free(s); return false; }
    override(&settings, overrides);
    if (!set_camera(s, &settings, path, report)) { scene_free(s); return false; }
    for (uint32_t i = 0; i < s->mesh.n_materials; i++) {
        s->has_specular |= material_is_specular(&s->mesh.material[i]);
        s->has_narrow |= material_is_narrow(&s->mesh.material[i]);
    }
    s->seconds_load = now() - start;

    start = now();
    bool built = build(s, effort);
    s->seconds_build = now() - start;
    if (built) return true;
    scene_free(s);
    return report_error(report, path, 0, "out of memory");
}

void scene_free(Scene *s)
{
    mesh_free(&s->mesh);
    bvh_free(s->bvh);
    lamps_free(s);
    free(s->rays);
    *s = (Scene){ 0 };
}

size_t scene_bytes(const Scene *s)
{
    const Mesh *m = &s->mesh;
    size_t a_triangle = 16u + (m->triangle_normal ? 12u : 0u) + (m->triangle_uv ? 12u : 0u);
    return m->n_triangles * a_triangle + 12 * ((size_t)m->n_positions + m->n_normals) + 8 * (size_t)m->n_uvs
         + lamps_bytes(s) + bvh_bytes(s->bvh);
}

/* The texel i of n; i is at most one off. */
static uint32_t texel(double i, uint32_t n, bool clamp)
{
    if (i < 0) return clamp ? 0 : n - 1;
    return i < n ? (uint32_t)i : clamp ? n - 1 : 0;
}

/* Bilinear, v upwards; texel centres at half integers. Repeated, as MTL has it unless told otherwise: at the border the texels of opposite sides
 * are neighbours and mix, which '-clamp on' is there to prevent. */
static Rgb texture_at(const Material *m, double u, double v)
{
    const Image *image = m->map_kd;
    const MapPlace *place = &m->map_place;
    double at[2] = { u * place->scale[0] + place->offset[0], v * place->scale[1] + place->offset[1] };
    for (int k = 0; k < 2; k++) at[k] = place->clamp ? fmin(fmax(at[k], 0), 1) : at[k] - floor(at[k]);
    double x = at[0] * image->width - 0.5, y = (1 - at[1]) * image->height - 0.5;
    double x0 = floor(x), y0 = floor(y), fx = x - x0, fy = y - y0;
    Rgb sum = vec3(0, 0, 0);
    for (int i = 0; i < 4; i++) {
        double weight = (i & 1 ? fx : 1 - fx) * (i & 2 ? fy : 1 - fy);
        uint32_t column = texel(x0 + (i & 1), image->width, place->clamp), row = texel(y0 + (i >> 1), image->height, place->clamp);
        sum = along(sum, weight, from_float(image->rgb + 3 * ((size_t)row * image->width + column)));
    }
    return sum;
}

/* Fills the surface at barycentric (u, v) of a triangle; c are its corners. */
static void set_point(const Scene *s, uint32_t triangle, const Vec3 c[3], double u, double v, Point *out)
{
    const Mesh *m = &s->mesh;
    double w = 1 - u - v;
    Vec3 e1 = sub(c[1], c[0]), e2 = sub(c[2], c[0]);
    Surface *surface = &out->surface;
    out->triangle = triangle;
    out->p = along(along(c[0], u, e1), v, e2);
    surface->ng = surface->ns = normalize(cross(e1, e2));
    surface->material = &m->material[m->triangle_material[triangle]];
    surface->kd = surface->material->kd;
    if (m->triangle_normal && m->triangle_normal[triangle][0] != BVH_NONE) {
        const uint32_t *n = m->triangle_normal[triangle];
        Vec3 sum = along(along(scale(w, from_float(m->normal[n[0]])), u, from_float(m->normal[n[1]])), v, from_float(m->normal[n[2]]));
        double l = length(sum);
        if (l > 0) surface->ns = scale(1 / l, sum);
    }
    if (surface->material->map_kd && m->triangle_uv && m->triangle_uv[triangle][0] != BVH_NONE) {
        const uint32_t *t = m->triangle_uv[triangle];
        double tu = w * (double)m->uv[t[0]][0] + u * (double)m->uv[t[1]][0] + v * (double)m->uv[t[2]][0];
        double tv = w * (double)m->uv[t[0]][1] + u * (double)m->uv[t[1]][1] + v * (double)m->uv[t[2]][1];
        surface->kd = texture_at(surface->material, tu, tv);
    }
}

/* Where a ray from there in direction w starts: off the surface, on the side of w. A point on the lens stays. */
static Vec3 leave(const Point *from, Vec3 w)
{
    if (from->triangle == BVH_NONE) return from->p;
    return along(from->p, copysign(rounding(from->p), dot(w, from->surface.ng)), from->surface.ng);
}

bool scene_trace(const Scene *s, const Point *from, Vec3 w, Point *hit)
{
    Ray ray = { leave(from, w), w, INFINITY, { from->triangle, BVH_NONE } };
    Hit h;
    ++*s->rays;
    if (!bvh_closest(s->bvh, &ray, &h)) return false;
    /* The tree says which triangle; where on it is computed anew in double [Moeller and Trumbore], kept inside the triangle: seen from the point itself, for
     * the direction between two points that are near each other, as in a pane, is to be w. */
    Vec3 c[3];
    corners(&s->mesh, h.triangle, c);
    Vec3 e1 = sub(c[1], c[0]), e2 = sub(c[2], c[0]), q = cross(w, e2), o = sub(from->p, c[0]);
    double det = dot(e1, q), inv = 1 / det, u = h.u, v = h.v;
    if (isfinite(inv)) {
        u = dot(o, q) * inv;
        v = dot(w, cross(o, e1)) * inv;
    }
    u = smaller(larger(u, 0), 1);
    v = smaller(larger(v, 0), 1 - u);
    set_point(s, h.triangle, c, u, v, hit);
    return true;
}

bool scene_visible(const Scene *s, const Point *a, const Point *b)
{
    Vec3 d = sub(b->p, a->p), from = leave(a, d);
    Ray ray = { from, sub(leave(b, neg(d)), from), 1, { a->triangle, b->triangle } };
    ++*s->rays;
    return !bvh_any(s->bvh, &ray);
}

double scene_triangle_area(const Scene *s, uint32_t triangle)
{
    Vec3 c[3];
    corners(&s->mesh, triangle, c);
    return 0.5 * length(cross(sub(c[1], c[0]), sub(c[2], c[0])));
}

void scene_triangle_point(const Scene *s, uint32_t triangle, double u, double v, Point *point)
{
    Vec3 c[3];
    corners(&s->mesh, triangle, c);
    set_point(s, triangle, c, u, v, point);
}

Vec3 scene_normal_change(const Scene *s, const Point *at, Vec3 d_p)
{
    const Mesh *m = &s->mesh;
    if (!m->triangle_normal || m->triangle_normal[at->triangle][0] == BVH_NONE) return vec3(0, 0, 0);
    Vec3 c[3], normal[3];
    corners(m, at->triangle, c);
    for (int i = 0; i < 3; i++) normal[i] = from_float(m->normal[m->triangle_normal[at->triangle][i]]);
    Vec3 e1 = sub(c[1], c[0]), e2 = sub(c[2], c[0]), across = cross(e1, e2), from = sub(at->p, c[0]), d1 = sub(normal[1], normal[0]), d2 = sub(normal[2], normal[0]);
    double squared = dot(across, across), u = dot(cross(from, e2), across) / squared, v = dot(cross(e1, from), across) / squared;
    double l = length(along(along(normal[0], u, d1), v, d2));
    Vec3 d = add(scale(dot(cross(d_p, e2), across) / squared, d1), scale(dot(cross(e1, d_p), across) / squared, d2));
    return l > 0 ? scale(1 / l, along(d, -dot(d, at->surface.ns), at->surface.ns)) : vec3(0, 0, 0);
}

void camera_lens_at(const Camera *camera, const double disk[2], Point *lens)
{
    *lens = (Point){ camera->eye, BVH_NONE, { NULL, { 0, 0, 0 }, camera->forward, camera->forward } };
    if (camera->aperture > 0) lens->p = along(along(camera->eye, camera->aperture * disk[0], camera->right), camera->aperture * disk[1], camera->up);
}

void camera_sample_lens(const Camera *camera, Rng *rng, Point *lens)
{
    double disk[2] = { 0, 0 };
    if (camera->aperture > 0) rng_disk(rng, &disk[0], &disk[1]);
    camera_lens_at(camera, disk, lens);
}

/* Through the point at distance 1 (pinhole) or at the focal plane (thin lens) that the centre of the lens sees at (x, y). */
Vec3 camera_direction(const Camera *camera, const Point *lens, double x, double y)
{
    double a = (2 * x / camera->width - 1) * camera->half_width, b = (1 - 2 * y / camera->height) * camera->half_height;
    Vec3 w = along(along(camera->forward, a, camera->right), b, camera->up);
    if (camera->aperture > 0) w = sub(along(camera->eye, camera->focus, w), lens->p);
    return normalize(w);
}

bool camera_project(const Camera *camera, const Point *lens, Vec3 w, double *x, double *y, double *we)
{
    double cosine = dot(w, camera->forward);
    if (!(cosine > 0)) return false;
    double a = dot(w, camera->right) / cosine, b = dot(w, camera->up) / cosine;
    if (camera->aperture > 0) {
        Vec3 off = sub(lens->p, camera->eye);
        a += dot(off, camera->right) / camera->focus;
        b += dot(off, camera->up) / camera->focus;
    }
    *x = 0.5 * (1 + a / camera->half_width) * camera->width;
    *y = 0.5 * (1 - b / camera->half_height) * camera->height;
    *we = 1 / (4 * camera->half_width * camera->half_height * cosine * cosine * cosine * cosine);
    return *x >= 0 && *x < camera->width && *y >= 0 && *y < camera->height;
}
