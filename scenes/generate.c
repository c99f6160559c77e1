/* Writes the shipped scenes' bigger meshes.
 *
 *     cc -o gen scenes/generate.c -lm && ./gen scenes test/scenes
 *
 * writes SCENES/{caustic,pool,glossy,door}.obj and TESTS/{mirror-smooth,water-smooth,underwater,lens-dof,dark,blind,texture,direct}.obj
 * and TESTS/checker.ppm, always the same bytes.  The .mtl and .cam files beside them, and cornell and furnace, are written by hand.
 *
 * Conventions: y is up.  Every face's vertices run counter-clockwise seen from its front: outwards for solids, inwards for rooms, on the side
 * that shines for lights, in the air for water.  Smooth surfaces carry their exact normals, which need no faith in the tessellation. */
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

static const double PI = 3.14159265358979323846;

typedef struct { double x, y, z; } Vec3;

static Vec3 vec(double x, double y, double z) { return (Vec3){ x, y, z }; }
static Vec3 add(Vec3 a, Vec3 b) { return vec(a.x + b.x, a.y + b.y, a.z + b.z); }
static Vec3 sub(Vec3 a, Vec3 b) { return vec(a.x - b.x, a.y - b.y, a.z - b.z); }
static Vec3 scale(double s, Vec3 a) { return vec(s * a.x, s * a.y, s * a.z); }
static double dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static Vec3 cross(Vec3 a, Vec3 b) { return vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
static Vec3 unit(Vec3 a) { return scale(1 / sqrt(dot(a, a)), a); }

/* ---- The file ---------------------------------------------------------------------------------------------------------------------- */

typedef struct {
    FILE *file;
    int positions, normals, uvs;   /* written so far; indices start at 1 */
} Obj;

static void fail(const char *what)
{
    perror(what);
    exit(EXIT_FAILURE);
}

static FILE *file_open(const char *folder, const char *name, const char *mode)
{
    char path[1024];
    int n = snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = n > 0 && (size_t)n < sizeof path ? fopen(path, mode) : NULL;
    if (!file)
        fail(path);
    return file;
}

/* `comment`: whole lines, each with its "# ". */
static Obj obj_begin(const char *folder, const char *name, const char *comment)
{
    char file_name[64];
    snprintf(file_name, sizeof file_name, "%s.obj", name);
    Obj obj = { file_open(folder, file_name, "w"), 0, 0, 0 };
    fprintf(obj.file, "%s#\n# Written by scenes/generate.c.\nmtllib %s.mtl\n", comment, name);
    return obj;
}

static void obj_end(Obj *obj)
{
    bool bad = ferror(obj->file);
    if (fclose(obj->file) || bad)
        fail("cannot write");
}

static void part(Obj *obj, const char *name, const char *material) { fprintf(obj->file, "\no %s\nusemtl %s\n", name, material); }

/* To a millionth, and never "-0": so that the last bit of somebody's sin() does not show. */
static double rounded(double x) { return floor(x * 1e6 + 0.5) / 1e6 + 0.0; }

static int position(Obj *obj, Vec3 p)
{
    fprintf(obj->file, "v %.6g %.6g %.6g\n", rounded(p.x), rounded(p.y), rounded(p.z));
    return ++obj->positions;
}

static void normal(Obj *obj, Vec3 n)
{
    fprintf(obj->file, "vn %.5g %.5g %.5g\n", rounded(n.x), rounded(n.y), rounded(n.z));
    obj->normals++;
}

/* ---- Flat things ------------------------------------------------------------------------------------------------------------------- */

/* Turned by `turn` radians about the y axis (x towards -z), then moved. */
typedef struct { Vec3 at; double turn; } Place;

static Vec3 turned(double turn, Vec3 p)
{
    double c = cos(turn), s = sin(turn);
    return vec(c * p.x + s * p.z, p.y, c * p.z - s * p.x);
}

static Vec3 placed(Place place, Vec3 p) { return add(place.at, turned(place.turn, p)); }

static const Place HERE = { { 0, 0, 0 }, 0 };

/* Corners counter-clockwise seen from the front. */
static void quad(Obj *obj, Vec3 a, Vec3 b, Vec3 c, Vec3 d)
{
    int first = position(obj, a);
    position(obj, b);
    position(obj, c);
    position(obj, d);
    fprintf(obj->file, "f %d %d %d %d\n", first, first + 1, first + 2, first + 3);
}

/* The parallelogram at `corner` spanned by u and v; its front is on the side of u x v. */
static void sheet(Obj *obj, Vec3 corner, Vec3 u, Vec3 v) { quad(obj, corner, add(corner, u), add(add(corner, u), v), add(corner, v)); }

/* A horizontal rectangle; its front looks up, or down. */
static void level(Obj *obj, double x0, double x1, double z0, double z1, double y, bool up)
{
    Vec3 u = vec(x1 - x0, 0, 0), v = vec(0, 0, z1 - z0);
    sheet(obj, vec(x0, y, z0), up ? v : u, up ? u : v);
}

/* A box with front outwards, or inwards (a room). */
static void box(Obj *obj, Vec3 low, Vec3 high, Place place, bool inwards)
{
    int first = obj->positions + 1;
    for (int i = 0; i < 8; i++)
        position(obj, placed(place, vec(i & 1 ? high.x : low.x, i & 2 ? high.y : low.y, i & 4 ? high.z : low.z)));
    static const int side[6][4] = { { 0, 4, 6, 2 }, { 1, 3, 7, 5 }, { 0, 1, 5, 4 }, { 2, 6, 7, 3 }, { 0, 2, 3, 1 }, { 4, 5, 7, 6 } };
    for (int i = 0; i < 6; i++) {
        fprintf(obj->file, "f");
        for (int k = 0; k < 4; k++)
            fprintf(obj->file, " %d", first + side[i][inwards ? 3 - k : k]);
        fprintf(obj->file, "\n");
    }
}

/* ---- Smooth things ----------------------------------------------------------------------------------------------------------------- */

typedef struct { Vec3 position, normal; } Sample;

/* A grid of rows x columns samples, its last column joined to the first if `closed`.  A row that is a single point (a pole) is written once.
 * Each face is turned so that it runs counter-clockwise seen from the side of its normals; without `smooth` these are not written. */
static void grid(Obj *obj, int rows, int columns, const Sample *sample, Place place, bool closed, bool smooth)
{
    int *index = malloc(sizeof *index * (size_t)(rows * columns));   /* relative to the first position written here */
    if (!index)
        fail("grid");
    int position_0 = obj->positions + 1, normal_0 = obj->normals + 1, n = 0;
    for (int r = 0; r < rows; r++) {
        Vec3 across = sub(sample[r * columns + 1].position, sample[r * columns].position);
        bool pole = dot(across, across) < 1e-18;
        for (int c = 0; c < columns; c++) {
            index[r * columns + c] = pole && c ? n - 1 : n;
            if (pole && c)
                continue;
            position(obj, placed(place, sample[r * columns + c].position));
            n++;
        }
    }
    for (int i = 0, done = 0; smooth && i < rows * columns; i++)
        if (index[i] == done) {
            normal(obj, turned(place.turn, sample[i].normal));
            done++;
        }
    for (int r = 0; r + 1 < rows; r++)
        for (int c = 0; c < (closed ? columns : columns - 1); c++) {
            int next = (c + 1) % columns, at[4] = { r * columns + c, r * columns + next, (r + 1) * columns + next, (r + 1) * columns + c };
            Vec3 p[4];
            for (int k = 0; k < 4; k++)
                p[k] = sample[at[k]].position;
            bool swap = dot(cross(sub(p[2], p[0]), sub(p[3], p[1])), add(sample[at[0]].normal, sample[at[2]].normal)) < 0;
            int previous = index[at[swap ? 0 : 3]];
            fprintf(obj->file, "f");
            for (int k = 0; k < 4; k++) {
                int i = index[at[swap ? 3 - k : k]];
                if (i != previous && smooth)
                    fprintf(obj->file, " %d//%d", position_0 + i, normal_0 + i);
                else if (i != previous)
                    fprintf(obj->file, " %d", position_0 + i);
                previous = i;
            }
            fprintf(obj->file, "\n");
        }
    free(index);
}

/* An outline (r, y) that runs from the bottom upwards, on the right of the axis; its outward normal is (y', -r'). */
typedef struct { double r, y, dr, dy; } Outline;

static void revolve(Obj *obj, int n, const Outline *outline, int around, Place place, bool smooth)
{
    Sample *sample = malloc(sizeof *sample * (size_t)(n * around));
    if (!sample)
        fail("revolve");
    for (int i = 0; i < n; i++)
        for (int k = 0; k < around; k++) {
            double angle = 2 * PI * k / around, c = cos(angle), s = sin(angle);
            Outline o = outline[i];
            sample[i * around + k] = (Sample){ vec(o.r * c, o.y, o.r * s), unit(vec(o.dy * c, -o.dr, o.dy * s)) };
        }
    grid(obj, n, around, sample, place, true, smooth);
    free(sample);
}

enum { OUTLINE_MAX = 256 };

/* An ellipsoid of revolution, `egg` = 0, or one whose lower half is the fuller one; it stands on y = 0. */
static void ball(Obj *obj, double radius, double height, double egg, int n, int around, Place place, bool smooth)
{
    Outline outline[OUTLINE_MAX];
    for (int i = 0; i <= n; i++) {
        double t = PI * i / n, s = sin(t), c = cos(t), fuller = 1 + egg * c;
        bool pole = i == 0 || i == n;
        outline[i] = (Outline){ pole ? 0 : radius * s * fuller, height / 2 * (1 - c), radius * (c * fuller - egg * s * s), pole ? 0 : height / 2 * s };
    }
    revolve(obj, n + 1, outline, around, place, smooth);
}

/* The solid whose outline is the Catmull-Rom spline through `knot` (r, y), from the axis to the axis, which it meets at a right angle. */
static void turned_solid(Obj *obj, int knots, const double knot[][2], int steps, int around, Place place)
{
    Outline outline[OUTLINE_MAX];
    int n = 0;
    for (int k = 0; k + 1 < knots; k++)
        for (int i = 0; i < steps + (k + 2 == knots); i++) {
            double t = (double)i / steps, value[2], slope[2];
            for (int axis = 0; axis < 2; axis++) {
                double mirror = axis ? 1 : -1;
                double a = k ? knot[k - 1][axis] : mirror * knot[1][axis], b = knot[k][axis], c = knot[k + 1][axis];
                double d = k + 2 < knots ? knot[k + 2][axis] : mirror * knot[k][axis];
                value[axis] = b + t / 2 * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)));
                slope[axis] = 0.5 * (c - a) + t * (2 * a - 5 * b + 4 * c - d) + 1.5 * t * t * (3 * (b - c) + d - a);
            }
            outline[n++] = (Outline){ value[0], value[1], slope[0], slope[1] };
        }
    revolve(obj, n, outline, around, place, true);
}

/* A tube of radius r0 .. r1 along a cubic Bezier curve in the (x, y) plane; its ends are open. */
static void tube(Obj *obj, const double bezier[4][2], double r0, double r1, int n, int around, Place place)
{
    Sample *sample = malloc(sizeof *sample * (size_t)((n + 1) * around));
    if (!sample)
        fail("tube");
    for (int i = 0; i <= n; i++) {
        double t = (double)i / n, u = 1 - t, p[2], d[2];
        for (int axis = 0; axis < 2; axis++) {
            double b0 = bezier[0][axis], b1 = bezier[1][axis], b2 = bezier[2][axis], b3 = bezier[3][axis];
            p[axis] = u * u * u * b0 + 3 * u * u * t * b1 + 3 * u * t * t * b2 + t * t * t * b3;
            d[axis] = 3 * (u * u * (b1 - b0) + 2 * u * t * (b2 - b1) + t * t * (b3 - b2));
        }
        double speed = sqrt(d[0] * d[0] + d[1] * d[1]), r = r0 + (r1 - r0) * t;
        Vec3 along = vec(d[0] / speed, d[1] / speed, 0), side = vec(-along.y, along.x, 0);
        for (int k = 0; k < around; k++) {
            double angle = 2 * PI * k / around;
            Vec3 out = add(scale(cos(angle), side), vec(0, 0, sin(angle)));
            sample[i * around + k] = (Sample){ add(vec(p[0], p[1], 0), scale(r, out)), unit(sub(out, scale((r1 - r0) / speed, along))) };
        }
    }
    grid(obj, n + 1, around, sample, place, true, true);
    free(sample);
}

/* ---- Water ------------------------------------------------------------------------------------------------------------------------- */

typedef struct { double direction, length, height, phase; } Wave;

/* The surface y = sum of waves over the rectangle, front and normals upwards (in the air). */
static void water(Obj *obj, double x0, double x1, double z0, double z1, int nx, int nz, int waves, const Wave *wave)
{
    Sample *sample = malloc(sizeof *sample * (size_t)((nx + 1) * (nz + 1)));
    if (!sample)
        fail("water");
    for (int j = 0; j <= nz; j++)
        for (int i = 0; i <= nx; i++) {
            double x = x0 + (x1 - x0) * i / nx, z = z0 + (z1 - z0) * j / nz, y = 0, dx = 0, dz = 0;
            for (int w = 0; w < waves; w++) {
                double k = 2 * PI / wave[w].length, kx = k * cos(wave[w].direction), kz = k * sin(wave[w].direction);
                double phase = kx * x + kz * z + wave[w].phase;
                y += wave[w].height * sin(phase);
                dx += wave[w].height * kx * cos(phase);
                dz += wave[w].height * kz * cos(phase);
            }
            sample[j * (nx + 1) + i] = (Sample){ vec(x, y, z), unit(vec(-dx, 1, -dz)) };
        }
    grid(obj, nz + 1, nx + 1, sample, HERE, false, true);
    free(sample);
}

/* The parallelogram at `corner` spanned by u and v, laid with nu x nv tiles: the tiles, or the joints of width `joint` between them. */
static void tiles(Obj *obj, Vec3 corner, Vec3 u, Vec3 v, int nu, int nv, double joint, bool joints)
{
    double lu = sqrt(dot(u, u)), lv = sqrt(dot(v, v)), tu = lu / nu, tv = lv / nv;
    u = unit(u);
    v = unit(v);
    if (joints)   /* whole strips along u, then the pieces between them */
        for (int j = 0; j < nv; j++) {
            sheet(obj, add(corner, scale(j * tv, v)), scale(lu, u), scale(joint, v));
            for (int i = 0; i < nu; i++)
                sheet(obj, add(corner, add(scale(i * tu, u), scale(j * tv + joint, v))), scale(joint, u), scale(tv - joint, v));
        }
    else
        for (int j = 0; j < nv; j++)
            for (int i = 0; i < nu; i++)
                sheet(obj, add(corner, add(scale(i * tu + joint, u), scale(j * tv + joint, v))), scale(tu - joint, u), scale(tv - joint, v));
}

/* ---- The scenes -------------------------------------------------------------------------------------------------------------------- */

static void caustic(const char *folder)
{
    Obj obj = obj_begin(folder, "caustic",
        "# A glass ball on a diffuse floor, lit by one small light: a caustic.\n"
        "#\n"
        "# The ball (index 1.5, smooth normals, front outwards) bundles the light into a bright spot in its shadow.  A path\n"
        "# tracer has to hit the small light by chance to find it; paths from the light find it at once.  Seen through the\n"
        "# ball, the caustic needs both.  The wall behind is lit by the light reflected off the ball, too.\n");
    part(&obj, "floor", "floor");
    level(&obj, -11, 11, -6, 6, 0, true);
    part(&obj, "wall", "wall");
    sheet(&obj, vec(-11, 0, -6), vec(22, 0, 0), vec(0, 7, 0));
    part(&obj, "ball", "glass");
    ball(&obj, 1, 2, 0, 84, 168, (Place){ { 0, 0.001, 0 }, 0 }, true);
    part(&obj, "light", "light");   /* aimed before the ball, so that it lights the whole floor */
    Vec3 at = vec(-3.6, 3.6, -3.2), towards = unit(sub(vec(-2, 0, -1.8), at)), u = unit(cross(vec(0, 1, 0), towards)), v = cross(towards, u);
    double half = 0.15;
    sheet(&obj, sub(at, scale(half, add(u, v))), scale(2 * half, u), scale(2 * half, v));
    obj_end(&obj);
}

static void pool(const char *folder)
{
    static const Wave wave[] = { { 0.35, 0.92, 0.0125, 0.3 }, { 1.25, 0.66, 0.0075, 1.9 }, { 2.30, 0.50, 0.0045, 4.1 },
                                 { 2.95, 0.75, 0.0090, 5.2 }, { 4.45, 0.41, 0.0028, 2.6 }, { 5.60, 0.57, 0.0056, 0.8 } };
    Obj obj = obj_begin(folder, "pool",
        "# A swimming pool at night: ripples on the water, and their caustics on the tiles, seen through the ripples.\n"
        "#\n"
        "# The water (index 1.33, front and smooth normals in the air) reaches from wall to wall and so bounds the water\n"
        "# body.  All light on the floor has come through the surface, and goes out through it again: paths L S D S E, which\n"
        "# neither next event estimation nor paths from the light can join, as long as the lamp and the eye are small.\n");
    double half = 2, floor_y = -1.4, deck_y = 0.14, edge = 0.25;
    for (int joints = 0; joints < 2; joints++) {
        part(&obj, joints ? "joints" : "tiles", joints ? "joint" : "tile");
        double w = 0.016, side = 2 * half, down = deck_y - floor_y;
        tiles(&obj, vec(-half, floor_y, half), vec(side, 0, 0), vec(0, 0, -side), 16, 16, w, joints);
        tiles(&obj, vec(-half, floor_y, -half), vec(side, 0, 0), vec(0, down, 0), 16, 5, w, joints);
        tiles(&obj, vec(half, floor_y, half), vec(-side, 0, 0), vec(0, down, 0), 16, 5, w, joints);
        tiles(&obj, vec(-half, floor_y, half), vec(0, 0, -side), vec(0, down, 0), 16, 5, w, joints);
        tiles(&obj, vec(half, floor_y, -half), vec(0, 0, side), vec(0, down, 0), 16, 5, w, joints);
    }
    part(&obj, "ball", "ball");   /* lost, on the bottom */
    ball(&obj, 0.24, 0.48, 0, 20, 40, (Place){ { 0.62, floor_y + 0.001, 0.1 }, 0 }, true);
    part(&obj, "water", "water");
    water(&obj, -half, half, -half, half, 128, 128, (int)(sizeof wave / sizeof *wave), wave);
    for (int outer = 0; outer < 2; outer++) {
        part(&obj, outer ? "deck" : "edge", outer ? "deck" : "edge");
        double a = outer ? half + edge : half, b = outer ? 5 : half + edge;
        level(&obj, -b, b, -b, -a, deck_y, true);
        level(&obj, -b, b, a, b, deck_y, true);
        level(&obj, -b, -a, -a, a, deck_y, true);
        level(&obj, a, b, -a, a, deck_y, true);
    }
    part(&obj, "wall", "wall");
    sheet(&obj, vec(-5, deck_y, -5), vec(10, 0, 0), vec(0, 4, 0));
    part(&obj, "light", "light");
    level(&obj, -1.32, -1.08, -1.92, -1.68, 5, false);
    obj_end(&obj);
}

static void glossy(const char *folder)
{
    Obj obj = obj_begin(folder, "glossy",
        "# Four Phong plates, from dull to almost a mirror, under four lights from large to small.\n"
        "#\n"
        "# After the plates by which Eric Veach explained multiple importance sampling.  Exponents 10, 100, 1000 and 10000\n"
        "# from the nearest plate to the farthest; the four spheres shine with about the same power, so that the smallest is the\n"
        "# brightest.  Each plate is tilted so that it shows the eye a reflection of every sphere: sharp small ones far\n"
        "# away, broad bands nearby.  Large light on the sharpest plate: only sampling the reflection works; small light on the\n"
        "# dullest: only sampling the light does.\n");
    Vec3 eye = vec(0, 2.2, 14), row = vec(0, 2.1, 0);
    static const double distance[4] = { 1.1, 2.9, 4.6, 6.2 };
    static const double height[4] = { -0.75, -1.15, -1.4, -1.55 };
    static const char *const plate[4] = { "plate10000", "plate1000", "plate100", "plate10" };
    for (int i = 0; i < 4; i++) {
        part(&obj, plate[i], plate[i]);
        Vec3 at = vec(0, height[i], distance[i]), up = unit(add(unit(sub(eye, at)), unit(sub(row, at))));
        Vec3 x = vec(0.62 * (eye.z - at.z), 0, 0), back = scale(-1.15 + 0.06 * i, unit(cross(vec(1, 0, 0), scale(-1, up)))), thick = scale(-0.08, up);
        if (back.z > 0)
            back = scale(-1, back);
        Vec3 corner = sub(at, scale(0.5, add(x, back)));   /* front left corner of the upper face */
        sheet(&obj, corner, x, back);
        sheet(&obj, add(corner, thick), x, scale(-1, thick));
        sheet(&obj, add(corner, add(back, thick)), scale(-1, thick), x);
        sheet(&obj, add(corner, thick), scale(-1, thick), back);
        sheet(&obj, add(add(corner, thick), x), back, scale(-1, thick));
        sheet(&obj, add(corner, thick), back, x);
    }
    part(&obj, "floor", "room");
    level(&obj, -12, 12, -4, 14, -2.2, true);
    part(&obj, "wall", "room");
    sheet(&obj, vec(-12, -2.2, -4), vec(24, 0, 0), vec(0, 12, 0));
    static const double radius[4] = { 0.9, 0.3, 0.1, 0.0333 };
    for (int i = 0; i < 4; i++) {
        static const char *const light[4] = { "light0", "light1", "light2", "light3" };
        static const int fine[4] = { 24, 16, 12, 8 };
        part(&obj, light[i], light[i]);
        ball(&obj, radius[i], 2 * radius[i], 0, fine[i], 2 * fine[i], (Place){ { 2.5 * i - 3.75, row.y - radius[i], 0 }, 0 }, false);
    }
    obj_end(&obj);
}

static void door(const char *folder)
{
    Obj obj = obj_begin(folder, "door",
        "# A room whose only light comes through a door ajar; the lamp is in the next room.\n"
        "#\n"
        "# After Eric Veach's room.  The lamp hangs beside the doorway, on the far side of the wall, and shines on the open door's\n"
        "# inner face: no ray goes from it past the door, so that all light here is indirect and has squeezed\n"
        "# through the gap.  With the door shut the room is black.  On the table: a glossy pot (Phong), a glass egg, a diffuse\n"
        "# bowl.\n");
    const double degrees = 35;              /* how far the door is open; 0 shuts out all light */
    const double x0 = -2.3, x1 = 2.6, z1 = 5.2, top = 2.6;        /* this room: z from 0 to z1 */
    const double thick = 0.14, z2 = -3.4, x2 = 1.6;               /* the wall; the next room: x from x0 to x2, z from z2 to -thick */
    const double left = -1.9, right = -1.05, high = 2.05;         /* the doorway */

    for (int odd = 0; odd < 2; odd++) {
        part(&obj, odd ? "tiles_dark" : "tiles_light", odd ? "tile_dark" : "tile_light");
        int nx = 10, nz = 10;
        for (int i = 0; i < nx; i++)
            for (int k = 0; k < nz; k++)
                if ((i + k) % 2 == odd)
                    level(&obj, x0 + (x1 - x0) * i / nx, x0 + (x1 - x0) * (i + 1) / nx, z1 * k / nz, z1 * (k + 1) / nz, 0, true);
    }
    part(&obj, "walls", "wall");
    sheet(&obj, vec(x0, 0, z1), vec(0, 0, -z1), vec(0, top, 0));
    sheet(&obj, vec(x1, 0, 0), vec(0, 0, z1), vec(0, top, 0));
    sheet(&obj, vec(x1, 0, z1), vec(x0 - x1, 0, 0), vec(0, top, 0));
    part(&obj, "back_wall", "back_wall");   /* around the doorway */
    sheet(&obj, vec(x0, 0, 0), vec(left - x0, 0, 0), vec(0, high, 0));
    sheet(&obj, vec(right, 0, 0), vec(x1 - right, 0, 0), vec(0, high, 0));
    sheet(&obj, vec(x0, high, 0), vec(x1 - x0, 0, 0), vec(0, top - high, 0));
    part(&obj, "ceiling", "ceiling");
    level(&obj, x0, x1, 0, z1, top, false);

    part(&obj, "doorway", "frame");
    level(&obj, left, right, -thick, 0, 0, true);
    level(&obj, left, right, -thick, 0, high, false);
    sheet(&obj, vec(left, 0, 0), vec(0, 0, -thick), vec(0, high, 0));
    sheet(&obj, vec(right, 0, -thick), vec(0, 0, thick), vec(0, high, 0));

    part(&obj, "next_room", "next_room");
    level(&obj, x0, x2, z2, -thick, 0, true);
    level(&obj, x0, x2, z2, -thick, top, false);
    sheet(&obj, vec(x0, 0, z2), vec(x2 - x0, 0, 0), vec(0, top, 0));
    sheet(&obj, vec(x0, 0, -thick), vec(0, 0, z2 + thick), vec(0, top, 0));
    sheet(&obj, vec(x2, 0, z2), vec(0, 0, -thick - z2), vec(0, top, 0));
    sheet(&obj, vec(left, 0, -thick), vec(x0 - left, 0, 0), vec(0, high, 0));
    sheet(&obj, vec(x2, 0, -thick), vec(right - x2, 0, 0), vec(0, high, 0));
    sheet(&obj, vec(x2, high, -thick), vec(x0 - x2, 0, 0), vec(0, top - high, 0));
    part(&obj, "lamp", "lamp");
    level(&obj, -0.6, 0.1, -0.95, -0.35, 2.45, false);

    /* The door overlaps its frame and sinks into the floor; it turns on the line where its back meets the wall: shut, it is tight. */
    const double lap = 0.03, leaf = 0.04;
    Place hinge = { { left - lap, -0.002, 0 }, -PI / 180 * degrees };
    part(&obj, "door", "door");
    box(&obj, vec(0, 0, 0), vec(right - left + 2 * lap, high + lap, leaf), hinge, false);
    part(&obj, "panels", "panel");
    for (int i = 0; i < 2; i++)
        box(&obj, vec(0.14, i ? 1.1 : 0.16, leaf), vec(right - left + 2 * lap - 0.14, i ? 1.94 : 0.94, leaf + 0.012), hinge, false);
    part(&obj, "door_handle", "brass");
    ball(&obj, 0.032, 0.064, 0, 12, 24, (Place){ placed(hinge, vec(right - left - 0.01, 0.99, leaf + 0.05)), 0 }, true);

    /* The table.  What stands on it or on the floor sinks in a little, so that no two faces lie on each other. */
    const Place table = { { 0.5, 0, 2.1 }, 0.18 };
    const double board = 0.78, wide = 0.85, deep = 0.5;   /* half extents */
    part(&obj, "table", "wood");
    box(&obj, vec(-wide, board - 0.05, -deep), vec(wide, board, deep), table, false);
    for (int i = 0; i < 4; i++) {
        double x = i & 1 ? wide - 0.1 : -wide + 0.04, z = i & 2 ? deep - 0.1 : -deep + 0.04;
        box(&obj, vec(x, -0.001, z), vec(x + 0.06, board - 0.05, z + 0.06), table, false);
    }

    /* The pot: body with its lid, spout, handle; it stands on the table, spout to the right. */
    static const double body[][2] = { { 0, 0 }, { 0.085, 0 }, { 0.105, 0.012 }, { 0.155, 0.075 }, { 0.168, 0.135 }, { 0.145, 0.195 }, { 0.108, 0.232 },
                                      { 0.104, 0.244 }, { 0.098, 0.252 }, { 0.06, 0.272 }, { 0.022, 0.281 }, { 0.014, 0.291 }, { 0.026, 0.310 }, { 0.016, 0.327 }, { 0, 0.331 } };
    static const double spout[4][2] = { { 0.12, 0.085 }, { 0.255, 0.085 }, { 0.205, 0.19 }, { 0.285, 0.235 } };
    static const double handle[4][2] = { { -0.125, 0.205 }, { -0.33, 0.26 }, { -0.31, 0.055 }, { -0.145, 0.065 } };
    Place pot = { placed(table, vec(-0.36, board - 0.0005, -0.06)), 0.45 };
    part(&obj, "pot", "copper");
    turned_solid(&obj, (int)(sizeof body / sizeof *body), body, 4, 72, pot);
    tube(&obj, spout, 0.045, 0.02, 14, 20, pot);
    tube(&obj, handle, 0.017, 0.017, 18, 14, pot);

    part(&obj, "egg", "glass");
    ball(&obj, 0.125, 0.34, 0.18, 40, 72, (Place){ placed(table, vec(0.12, board + 0.0005, 0.14)), 0 }, true);

    static const double bowl[][2] = { { 0, 0 }, { 0.07, 0 }, { 0.08, 0.01 }, { 0.085, 0.025 }, { 0.15, 0.07 }, { 0.19, 0.13 }, { 0.205, 0.185 }, { 0.197, 0.19 },
                                      { 0.189, 0.183 }, { 0.175, 0.13 }, { 0.135, 0.08 }, { 0.06, 0.04 }, { 0, 0.035 } };
    part(&obj, "bowl", "clay");
    turned_solid(&obj, (int)(sizeof bowl / sizeof *bowl), bowl, 3, 72, (Place){ placed(table, vec(0.5, board - 0.0005, -0.12)), 0 });
    obj_end(&obj);
}

/* ---- The tests' scenes ------------------------------------------------------------------------------------------------------------- */

static void mirror_smooth(const char *folder)
{
    Obj obj = obj_begin(folder, "mirror-smooth",
        "# A coarse mirror ball with smooth normals over a diffuse floor, one small light.\n"
        "# Eight facets from pole to pole: shading and face normals differ a lot, so that every place where the one is taken\n"
        "# for the other shows.\n");
    part(&obj, "floor", "floor");
    level(&obj, -4, 4, -4, 4, 0, true);
    part(&obj, "mirror", "mirror");
    ball(&obj, 1, 2, 0, 8, 16, (Place){ { 0, 0.1, 0 }, 0 }, true);
    part(&obj, "light", "light");
    level(&obj, 1.6, 2.4, -0.4, 0.4, 4, false);
    obj_end(&obj);
}

static const Wave TEST_WAVE[] = { { 0.4, 1.7, 0.05, 0.3 }, { 1.9, 1.3, 0.04, 1.1 }, { 4.0, 1.1, 0.03, 2.5 } };

/* A basin 2 x 2 x 1 full of water up to y = 0, its rim at 0.2, and a light above. */
static void basin(const char *folder, const char *name, const char *comment, double light)
{
    Obj obj = obj_begin(folder, name, comment);
    part(&obj, "floor", "floor");
    level(&obj, -1, 1, -1, 1, -1, true);
    part(&obj, "walls", "wall");
    sheet(&obj, vec(-1, -1, -1), vec(2, 0, 0), vec(0, 1.2, 0));
    sheet(&obj, vec(1, -1, 1), vec(-2, 0, 0), vec(0, 1.2, 0));
    sheet(&obj, vec(-1, -1, 1), vec(0, 0, -2), vec(0, 1.2, 0));
    sheet(&obj, vec(1, -1, -1), vec(0, 0, 2), vec(0, 1.2, 0));
    part(&obj, "water", "water");
    water(&obj, -1, 1, -1, 1, 12, 12, (int)(sizeof TEST_WAVE / sizeof *TEST_WAVE), TEST_WAVE);
    part(&obj, "light", "light");
    level(&obj, 0.3 - light / 2, 0.3 + light / 2, -0.4 - light / 2, -0.4 + light / 2, 2, false);
    obj_end(&obj);
}

static void lens_dof(const char *folder)
{
    Obj obj = obj_begin(folder, "lens-dof",
        "# Three diffuse bars at three depths before a thin lens, and a mirror: only the middle one is in focus,\n"
        "# in the mirror, none at the mirror's own distance: what counts is the whole way of the light.\n");
    part(&obj, "floor", "floor");
    level(&obj, -3, 3, -5, 3, 0, true);
    static const char *const bar[3] = { "near", "middle", "far" };
    for (int i = 0; i < 3; i++) {
        part(&obj, bar[i], bar[i]);
        box(&obj, vec(-0.2, -0.01, -0.2), vec(0.2, 1.2, 0.2), (Place){ { 0.8 * i - 1.1, 0, 1.2 - 1.8 * i }, 0.3 }, false);
    }
    part(&obj, "mirror", "mirror");
    sheet(&obj, vec(0.95, 0.05, -0.6), vec(0.93, 0, 0.76), vec(0, 1.5, 0));
    part(&obj, "light", "light");
    level(&obj, -1, 1, -1, 1, 4, false);
    obj_end(&obj);
}

static void dark(const char *folder)
{
    Obj obj = obj_begin(folder, "dark", "# A box on a floor, and no light at all: a warning and a black picture.\n");
    part(&obj, "floor", "grey");
    level(&obj, -2, 2, -2, 2, 0, true);
    part(&obj, "box", "grey");
    box(&obj, vec(-0.5, -0.01, -0.5), vec(0.5, 1, 0.5), HERE, false);
    obj_end(&obj);
}

static void blind(const char *folder)
{
    Obj obj = obj_begin(folder, "blind",
        "# A box on a floor under a light that faces up, into the void: the camera sees no light, not even its back.\n"
        "# A warning and a black picture.\n");
    part(&obj, "floor", "grey");
    level(&obj, -2, 2, -2, 2, 0, true);
    part(&obj, "box", "grey");
    box(&obj, vec(-0.5, -0.01, -0.5), vec(0.5, 1, 0.5), HERE, false);
    part(&obj, "light", "light");
    level(&obj, -0.5, 0.5, -0.5, 0.5, 3, true);
    obj_end(&obj);
}

static void texture(const char *folder)
{
    enum { SIZE = 8 };
    Obj obj = obj_begin(folder, "texture",
        "# One textured square that fills the picture but for a margin, evenly lit from far away.\n"
        "# Seen from the front, u runs to the right and v upwards, and the texture's first row of pixels is its top:\n"
        "# upper left red, upper right green, lower left blue, lower right white, with a darker checkerboard.\n");
    part(&obj, "square", "textured");
    fprintf(obj.file, "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n");
    obj.positions += 4;
    part(&obj, "light", "light");
    sheet(&obj, vec(4, -4, 20), vec(-8, 0, 0), vec(0, 8, 0));
    obj_end(&obj);

    FILE *file = file_open(folder, "checker.ppm", "w");
    fprintf(file, "P3\n# Written by scenes/generate.c.\n%d %d\n255\n", SIZE, SIZE);
    for (int y = 0; y < SIZE; y++)
        for (int x = 0; x < SIZE; x++) {
            int value = (x + y) % 2 ? 128 : 255;
            bool right = x >= SIZE / 2, low = y >= SIZE / 2;
            fprintf(file, "%d %d %d\n", right == low ? value : 0, right ? value : 0, low ? value : 0);
        }
    if (fclose(file))
        fail("checker.ppm");
}

static void direct(const char *folder)
{
    Obj obj = obj_begin(folder, "direct",
        "# One light seen four times: itself, in a flat mirror, through a glass pane, and through a glass ball\n"
        "# (paths L S* E), over a diffuse floor.\n");
    part(&obj, "floor", "floor");
    level(&obj, -3, 3, -3, 3, 0, true);
    part(&obj, "light", "light");   /* faces the eye */
    sheet(&obj, vec(-0.5, 1.2, -2), vec(1, 0, 0), vec(0, 0.8, 0));
    part(&obj, "mirror", "mirror");
    sheet(&obj, vec(-2.2, 0.1, -1.0), vec(0.8, 0, -1.0), vec(0, 2.2, 0));
    part(&obj, "pane", "glass");    /* before the light's lower half */
    box(&obj, vec(-1.2, 0.4, -0.05), vec(1.2, 1.6, 0.05), (Place){ { 0, 0, -1.2 }, 0.25 }, false);
    part(&obj, "ball", "glass");
    ball(&obj, 0.45, 0.9, 0, 16, 32, (Place){ { 0.75, 0.4, 0.6 }, 0 }, true);
    obj_end(&obj);
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        fprintf(stderr, "usage: %s SCENES TESTS\n", argv[0]);
        return 2;
    }
    caustic(argv[1]);
    pool(argv[1]);
    glossy(argv[1]);
    door(argv[1]);
    mirror_smooth(argv[2]);
    basin(argv[2], "water-smooth",
        "# Rippled, coarse water with smooth normals in a basin; eye and light in the air: paths L S D S E.\n", 0.6);
    basin(argv[2], "underwater",
        "# The eye is under the rippled water and looks along and up; the light is in the air: paths L S D E, L S E,\n"
        "# total reflection, and the radiance's factor of index squared.\n", 0.8);
    lens_dof(argv[2]);
    dark(argv[2]);
    blind(argv[2]);
    texture(argv[2]);
    direct(argv[2]);
    return 0;
}
