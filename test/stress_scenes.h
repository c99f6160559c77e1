/* The scenes of stress.c: each is written as NAME.obj, NAME.mtl and NAME.cam by a function, so that nothing about them is hidden in a mesh file.
 *
 * y is up. Every face runs counter-clockwise seen from its front: outwards for solids, inwards for rooms, on the side that shines for lights, in
 * the air for water. Most scenes are a room from -1 to 1 whose lamp is large enough for a path tracer to meet by itself. */
#ifndef STRESS_SCENES_H
#define STRESS_SCENES_H
#include "rng.h"
#include "vec.h"
#include <stdio.h>
#include <string.h>

typedef struct {
    FILE *obj, *mtl, *cam, *map;   /* map: a picture, NAME.ppm */
    const char *name;              /* file name without folder and ending */
    double scale;                  /* what is written is scale * p + shift */
    Vec3 shift;
} Files;

/* ---- parts ---- */

static Vec3 placed(const Files *f, Vec3 p) { return along(f->shift, f->scale, p); }

static void vertex(Files *f, Vec3 p)
{
    p = placed(f, p);
    fprintf(f->obj, "v %.17g %.17g %.17g\n", p.x, p.y, p.z);
}

static void use(Files *f, const char *material) { fprintf(f->obj, "usemtl %s\n", material); }
static void material(Files *f, const char *name, const char *statements) { fprintf(f->mtl, "newmtl %s\n%s\n", name, statements); }

static void triangle(Files *f, Vec3 a, Vec3 b, Vec3 c)
{
    vertex(f, a);
    vertex(f, b);
    vertex(f, c);
    fputs("f -3 -2 -1\n", f->obj);
}

static void quad(Files *f, Vec3 a, Vec3 b, Vec3 c, Vec3 d)
{
    vertex(f, a);
    vertex(f, b);
    vertex(f, c);
    vertex(f, d);
    fputs("f -4 -3 -2 -1\n", f->obj);
}

/* A horizontal rectangle about (x, z); its front looks up, or down. */
static void level(Files *f, double x, double z, double half_x, double half_z, double y, bool up)
{
    Vec3 a = vec3(x - half_x, y, z - half_z), b = vec3(x - half_x, y, z + half_z), c = vec3(x + half_x, y, z + half_z), d = vec3(x + half_x, y, z - half_z);
    if (up) quad(f, a, b, c, d);
    else quad(f, d, c, b, a);
}

/* Side of an axis-aligned box: axis 0..2, high or low; its front outwards, or inwards. */
static void side(Files *f, Vec3 low, Vec3 high, int axis, bool at_high, bool inwards)
{
    double lo[3] = { low.x, low.y, low.z }, hi[3] = { high.x, high.y, high.z };
    int u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (int i = 0; i < 4; i++) {
        int corner = at_high != inwards ? i : 3 - i;       /* u x v points along the axis */
        double p[3];
        p[axis] = at_high ? hi[axis] : lo[axis];
        p[u] = corner == 1 || corner == 2 ? hi[u] : lo[u];
        p[v] = corner >= 2 ? hi[v] : lo[v];
        vertex(f, vec3(p[0], p[1], p[2]));
    }
    fputs("f -4 -3 -2 -1\n", f->obj);
}

static void box(Files *f, Vec3 low, Vec3 high, bool inwards)
{
    for (int i = 0; i < 6; i++) side(f, low, high, i / 2, i % 2, inwards);
}

typedef enum { FLAT, SMOOTH } Normals;

/* A ball of 2n sectors and n rings, its radius varied by 'bumps'. With SMOOTH the normals are those of a perfect ball. */
static void ball(Files *f, Vec3 centre, double radius, int n, double bumps, Normals normals)
{
    int sectors = 2 * n, total = (n + 1) * sectors;
    for (int i = 0; i <= n; i++)
        for (int j = 0; j < sectors; j++) {
            double theta = PI * i / n, phi = PI * j / n, r = radius * (1 + bumps * sin(9 * theta) * cos(7 * phi));
            Vec3 w = vec3(sin(theta) * cos(phi), cos(theta), sin(theta) * sin(phi));
            vertex(f, along(centre, r, w));
            if (normals == SMOOTH) fprintf(f->obj, "vn %.9g %.9g %.9g\n", w.x, w.y, w.z);
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < sectors; j++) {
            int next = (j + 1) % sectors, v[4] = { i * sectors + j, i * sectors + next, (i + 1) * sectors + next, (i + 1) * sectors + j };
            fputs("f", f->obj);
            for (int k = 0; k < 4; k++) {
                fprintf(f->obj, " %d", v[k] - total);
                if (normals == SMOOTH) fprintf(f->obj, "//%d", v[k] - total);
            }
            fputs("\n", f->obj);
        }
}

static void camera(Files *f, Vec3 eye, Vec3 look, double fov)
{
    eye = placed(f, eye);
    look = placed(f, look);
    fprintf(f->cam, "eye %.17g %.17g %.17g\nlook %.17g %.17g %.17g\nfov %.17g\n", eye.x, eye.y, eye.z, look.x, look.y, look.z, fov);
}

/* ---- the room ---- */

static const Vec3 LOW = { -1, -1, -1 }, HIGH = { 1, 1, 1 };

/* What most scenes use. */
static void materials(Files *f)
{
    material(f, "white", "Kd 0.7 0.7 0.7");
    material(f, "red", "Kd 0.6 0.1 0.1");
    material(f, "green", "Kd 0.1 0.5 0.1");
    material(f, "black", "Kd 0 0 0");
    material(f, "lamp", "Kd 0 0 0\nKe 6 5 4");
    material(f, "mirror", "illum 3\nKs 0.9 0.9 0.9");
    material(f, "glass", "illum 4\nNi 1.5");
}

static void walls(Files *f, bool front)
{
    use(f, "white");
    side(f, LOW, HIGH, 1, false, true);
    side(f, LOW, HIGH, 1, true, true);
    side(f, LOW, HIGH, 2, false, true);
    if (front) side(f, LOW, HIGH, 2, true, true);
    use(f, "red");
    side(f, LOW, HIGH, 0, false, true);
    use(f, "green");
    side(f, LOW, HIGH, 0, true, true);
}

static void lamp(Files *f, double half)
{
    use(f, "lamp");
    level(f, 0, 0, half, half, 0.96875, false);
}

/* Open towards the camera. */
static void room(Files *f)
{
    materials(f);
    walls(f, false);
    lamp(f, 0.625);
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

static void block(Files *f)
{
    use(f, "white");
    box(f, vec3(-0.625, -1, -0.5), vec3(0.125, 0.25, 0.25), false);
}

static void furnished(Files *f, double unused)
{
    (void)unused;
    room(f);
    block(f);
}

/* ---- degenerate meshes ---- */

static void slivers(Files *f, double unused)
{
    (void)unused;
    furnished(f, 0);
    Rng rng = rng_new(1, 1);
    for (int i = 0; i < 60; i++) {
        Vec3 a = vec3(2 * rng_double(&rng) - 1, 2 * rng_double(&rng) - 1, 2 * rng_double(&rng) - 1), b = neg(a);
        double width = i % 3 ? 1e-7 : 0;                   /* a third have no area: all in a line, or two corners in one */
        triangle(f, a, b, along(scale(i % 2 ? 0.5 : 1, a), width, vec3(rng_double(&rng), rng_double(&rng), 1)));
    }
    Vec3 hub = vec3(1, -0.9375, 1);                        /* a second floor: a fan of needles */
    for (int i = 0; i < 250; i++) triangle(f, hub, vec3(0.008 * i - 1, -0.9375, -1), vec3(0.008 * (i - 1) - 1, -0.9375, -1));
}

/* All faces twice, once more from the other side, lamps too. */
static void duplicates(Files *f, double unused)
{
    (void)unused;
    room(f);
    walls(f, false);
    block(f);
    block(f);
    use(f, "white");
    box(f, vec3(-0.625, -1, -0.5), vec3(0.125, 0.25, 0.25), true);
    lamp(f, 0.625);
}

/* A lamp that shines to both sides: two faces with the same corners, one turned over. */
static void two_sided_lamp(Files *f, double unused)
{
    (void)unused;
    materials(f);
    walls(f, false);
    block(f);
    use(f, "lamp");
    level(f, 0, 0, 0.5, 0.5, 0.5, false);
    level(f, 0, 0, 0.5, 0.5, 0.5, true);
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

/* Carpets in the floor's own plane, overlapping it and each other. */
static void coplanar(Files *f, double unused)
{
    (void)unused;
    furnished(f, 0);
    for (int i = 0; i < 3; i++) level(f, 0.25 * i, 0.375, 0.5, 0.4, -1, true);
}

static void coplanar_colours(Files *f, double unused)
{
    (void)unused;
    furnished(f, 0);
    use(f, "red");
    level(f, 0.25, 0.375, 0.5, 0.4, -1, true);
    use(f, "mirror");
    level(f, 0.5, 0.5, 0.3, 0.3, -1, true);
}

/* A lamp that leans into the corner of floor and wall, and shares edges with both; another that hangs on the ceiling's edge. */
static void touching_lamp(Files *f, double unused)
{
    (void)unused;
    materials(f);
    walls(f, false);
    block(f);
    use(f, "lamp");
    quad(f, vec3(1, -1, 0.5), vec3(1, -1, -0.5), vec3(0.5, -0.5, -0.5), vec3(0.5, -0.5, 0.5));
    quad(f, vec3(1, -1, -0.5), vec3(1, -1, 0.5), vec3(0.5, -0.5, 0.5), vec3(0.5, -0.5, -0.5));
    quad(f, vec3(-1, 1, -1), vec3(0, 1, -1), vec3(0, 0.5, -1), vec3(-1, 0.5, -1));
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

/* The lamp lies in the ceiling's own plane. */
static void lamp_in_ceiling(Files *f, double unused)
{
    (void)unused;
    materials(f);
    walls(f, false);
    block(f);
    use(f, "lamp");
    level(f, 0.25, 0, 0.625, 0.625, 1, false);
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

/* Corners on corners, edges on edges, a point on a face. */
static void corners(Files *f, double unused)
{
    (void)unused;
    room(f);
    use(f, "white");
    box(f, vec3(-1, -1, -1), vec3(-0.5, 0, -0.5), false);
    box(f, vec3(-0.5, -1, -0.5), vec3(0, -0.5, 0), false);
    box(f, vec3(0.5, 0.5, -1), vec3(1, 1, -0.5), false);
    use(f, "mirror");
    triangle(f, vec3(0, -0.5, 0), vec3(0.5, -1, 0), vec3(0.5, 0.5, -0.5));
    use(f, "red");
    ball(f, vec3(0.5, -0.75, 0.5), 0.25, 6, 0, FLAT);
}

/* ---- glass ---- */

/* A sheet, a bowl without a lid, and two panes that cut through each other: nothing is closed. */
static void open_glass(Files *f, double half)
{
    materials(f);
    walls(f, false);
    lamp(f, half);
    use(f, "glass");
    level(f, -0.25, 0, 0.5, 0.5, -0.25, true);
    quad(f, vec3(0, -1, 0), vec3(0.75, -0.9375, 0.375), vec3(0.75, 0.5, 0.25), vec3(0, 0.5, -0.25));
    for (int i = 0; i < 4; i++) {
        double a = PI * i / 2, b = a + PI / 2;
        triangle(f, vec3(0.5, -0.875, 0.25), vec3(0.5 + 0.4 * cos(b), -0.5, 0.25 + 0.4 * sin(b)), vec3(0.5 + 0.4 * cos(a), -0.5, 0.25 + 0.4 * sin(a)));
    }
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

static void refraction(Files *f, double ni)
{
    room(f);
    fprintf(f->mtl, "newmtl odd\nillum 4\nNi %.17g\n", ni);
    use(f, "odd");
    ball(f, vec3(0, -0.375, 0.25), 0.5, 24, 0, SMOOTH);
}

static void eye_in_glass(Files *f, double unused)
{
    (void)unused;
    materials(f);
    walls(f, true);
    lamp(f, 0.625);
    block(f);
    use(f, "glass");
    ball(f, vec3(0.5, 0, 0.5), 0.25, 24, 0, SMOOTH);
    camera(f, vec3(0.55, 0.05, 0.6), vec3(-0.5, -0.5, -0.5), 60);
}

static void under_water(Files *f, double unused)
{
    (void)unused;
    materials(f);
    material(f, "water", "illum 4\nNi 1.33");
    walls(f, true);
    lamp(f, 0.75);
    block(f);
    use(f, "water");
    level(f, 0, 0, 1, 1, 0.375, true);
    camera(f, vec3(0.5, 0, 0.875), vec3(-0.25, 0, -0.5), 75);
}

/* Thirty panes, sixty surfaces, between the eye and a small part of the room that has the only light. */
static void panes(Files *f, double unused)
{
    (void)unused;
    materials(f);
    material(f, "pane", "illum 4\nNi 1.1");
    walls(f, true);
    use(f, "lamp");
    level(f, 0, -0.6875, 0.875, 0.25, 0.96875, false);
    use(f, "pane");
    for (int i = 0; i < 30; i++) box(f, vec3(-1, -1, 0.6875 - 0.03125 * i), vec3(1, 1, 0.703125 - 0.03125 * i), false);
    camera(f, vec3(0, 0, 0.9375), vec3(0, 0, -1), 50);
}

/* ---- cameras ---- */

/* On the very floor; its coordinate survives in a float, or not. */
static void eye_on_floor(Files *f, double tilt)
{
    Vec3 eye = vec3(0.25, -1, 0.75);
    materials(f);
    use(f, "white");
    side(f, LOW, HIGH, 2, false, true);
    side(f, LOW, HIGH, 2, true, true);
    use(f, "red");
    side(f, LOW, HIGH, 0, false, true);
    use(f, "green");
    side(f, LOW, HIGH, 0, true, true);
    use(f, "white");
    side(f, LOW, HIGH, 1, true, true);
    if (tilt > 0) {                                        /* a floor that slopes, the eye in its middle as well as that can be written */
        double y[3] = { -1 - tilt / 3, -1 + tilt / 7, -1 + tilt };
        Vec3 a = vec3(-1, y[0], 1), b = vec3(1, y[1], 1), c = vec3(0, y[2], -1);
        triangle(f, a, b, c);
        eye = scale(1.0 / 3, add(a, add(b, c)));
    } else side(f, LOW, HIGH, 1, false, true);
    lamp(f, 0.625);
    camera(f, eye, vec3(-0.25, -0.5, -1), 70);
}

static void thin_lens(Files *f, double unused)
{
    furnished(f, unused);
    fprintf(f->cam, "aperture %.17g\nfocus %.17g\n", 0.25 * f->scale, 3.5 * f->scale);
}

/* A film so small that all its rays run along an axis, their other components next to nothing or, for the tree, nothing at all; a mirror turns
 * them to another axis. */
static void axis_rays(Files *f, double fov)
{
    materials(f);
    walls(f, true);
    lamp(f, 0.625);
    use(f, "mirror");
    quad(f, vec3(-0.5, -0.5, -0.5), vec3(0.5, -0.5, -0.5), vec3(0.5, 0.5, 0.5), vec3(-0.5, 0.5, 0.5));
    camera(f, vec3(0.3125, 0.125, 0.9375), vec3(0.3125, 0.125, 0), fov);
}

/* ---- lights ---- */

static void odd_lights(Files *f, double unused)
{
    furnished(f, unused);
    material(f, "out", "Ke 0 0 0");
    use(f, "out");
    level(f, 0, 0, 0.5, 0.5, 0.5, false);
    use(f, "lamp");
    triangle(f, vec3(0, 0, 0), vec3(0.5, 0.5, 0.5), vec3(0.5, 0.5, 0.5));
    triangle(f, vec3(0, 0, 0), vec3(0.25, 0.25, 0.25), vec3(0.5, 0.5, 0.5));
}

static void no_light(Files *f, double unused)
{
    (void)unused;
    materials(f);
    walls(f, false);
    use(f, "lamp");
    triangle(f, vec3(0, 0, 0), vec3(0.25, 0.25, 0.25), vec3(0.5, 0.5, 0.5));
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

/* The lamp shines inside a closed box. */
static void hidden_light(Files *f, double unused)
{
    (void)unused;
    materials(f);
    walls(f, false);
    use(f, "white");
    box(f, vec3(-0.5, -0.5, -0.5), vec3(0.5, 0.5, 0.5), false);
    use(f, "lamp");
    level(f, 0, 0, 0.25, 0.25, 0, false);
    camera(f, vec3(0, 0, 3.75), vec3(0, 0, 0), 40);
}

static void radiance(Files *f, double ke)
{
    fprintf(f->mtl, "newmtl lamp\nKd 0 0 0\nKe %.17g %.17g %.17g\n", ke, ke, ke);      /* the first definition counts */
    furnished(f, 0);
}

/* Radiance 1e20, reflectance 1e-10: what reaches the lens after k bounces is 10^(20 - 10 k). The lamp is out of sight. */
static void vast_range(Files *f, double unused)
{
    (void)unused;
    material(f, "white", "Kd 1e-10 1e-10 1e-10");
    material(f, "green", "Kd 1e-10 1e-10 1e-10");
    material(f, "red", "Kd 1e-10 0 0\nKs 0 1e-10 1e-10\nNs 10");
    material(f, "lamp", "Kd 0 0 0\nKe 1e20 1e20 1e20");
    materials(f);
    walls(f, true);
    lamp(f, 0.625);
    block(f);
    camera(f, vec3(0, 0, 0.9375), vec3(0, -0.75, -0.5), 60);
}

/* ---- sizes and places ---- */

static void placed_room(Files *f, double scale_by)
{
    f->scale = scale_by;
    furnished(f, 0);
}

static void far_room(Files *f, double distance)
{
    f->shift = vec3(distance, -distance / 3, distance / 7);
    furnished(f, 0);
}

static void long_plane(Files *f, double half)
{
    furnished(f, 0);
    use(f, "white");
    level(f, 0, 0, half, 1, -1.125, true);
}

static void million(Files *f, double unused)
{
    (void)unused;
    room(f);
    use(f, "white");
    ball(f, vec3(0, -0.25, 0), 0.625, 500, 0.1, FLAT);
}

/* ---- surfaces ---- */

static void glossy(Files *f, double ns)
{
    fprintf(f->mtl, "newmtl white\nKd 0.2 0.2 0.2\nKs 0.5 0.6 0.4\nNs %.17g\n", ns);
    furnished(f, 0);
}

/* Coarse balls with the normals of fine ones, and a wall whose normals lean far over. */
static void bent_normals(Files *f, double unused)
{
    (void)unused;
    room(f);
    material(f, "shiny", "Kd 0.3 0.3 0.3\nKs 0.4 0.4 0.4\nNs 30");
    use(f, "shiny");
    ball(f, vec3(-0.5, -0.5, 0.25), 0.375, 3, 0, SMOOTH);
    use(f, "mirror");
    ball(f, vec3(0.5, -0.5, 0), 0.375, 3, 0, SMOOTH);
    use(f, "glass");
    ball(f, vec3(0.5, 0.25, -0.25), 0.3, 3, 0, SMOOTH);
    use(f, "white");
    vertex(f, vec3(-0.875, -0.25, -0.875));
    vertex(f, vec3(0.25, -0.25, -0.875));
    vertex(f, vec3(0.25, 0.75, -0.875));
    vertex(f, vec3(-0.875, 0.75, -0.875));
    fputs("vn 3 0 1\nvn -3 0 1\nvn -1 -3 1\nvn 0 3 -0.5\nf -4//-4 -3//-3 -2//-2 -1//-1\n", f->obj);
}

static void textured(Files *f, double unused)
{
    room(f);
    (void)unused;
    fprintf(f->map, "P6\n4 2\n255\n");
    for (int i = 0; i < 24; i++) fputc(i * 89 % 256, f->map);
    fprintf(f->mtl, "newmtl paper\nmap_Kd %s.ppm\nKs 0.1 0.1 0.1\nNs 5\n", f->name);
    use(f, "paper");
    fputs("vt -1.25 0\nvt 1.5 0\nvt 1.5 2\nvt -1.25 2.5\n", f->obj);
    vertex(f, vec3(-0.75, -0.75, -0.25));
    vertex(f, vec3(0.75, -0.75, -0.25));
    vertex(f, vec3(0.75, 0.5, -0.5));
    vertex(f, vec3(-0.75, 0.5, -0.5));
    fputs("f -4/-4 -3/-3 -2/-2 -1/-1\n", f->obj);
}

/* ---- furnaces: the eye inside a closed box whose walls all shine and reflect alike. Every value is ke (1 + r + r^2 + .. ) ---- */

static void furnace_of(Files *f, const char *wall, Vec3 inner_low)
{
    material(f, "wall", wall);
    use(f, "wall");
    box(f, LOW, HIGH, true);
    box(f, inner_low, vec3(0.25, 0.25, 0), false);
    camera(f, vec3(-0.5, 0.25, 0.75), vec3(0.25, -0.25, -0.5), 70);
}

static void mirror_furnace(Files *f, double unused)
{
    (void)unused;
    furnace_of(f, "illum 3\nKs 0.9 0.9 0.9\nKe 1 1 1", vec3(-0.25, -0.5, -0.5));
}

static void diffuse_furnace(Files *f, double unused)
{
    (void)unused;
    furnace_of(f, "Kd 0.9 0.9 0.9\nKe 1 1 1", vec3(-0.25, -0.5, -0.5));
}
#endif
