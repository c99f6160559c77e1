/* Times the ray queries: building, bytes a triangle, and million rays a second, on generated scenes or a given OBJ file.
 *
 *     bench_rays [--size SHARE] [--rays N] [--repeats N] [--dump PREFIX] [SCENE | FILE.obj] ...
 *
 * SCENE is sphere, room, box or furniture (all four if none is given); SHARE scales the number of their triangles. Rays are those of a path
 * tracer: 'camera' rays, 'bounce' rays that leave surfaces with the cosine law, 'segment's between vertices of different paths. Each is rounded
 * to float first, and no triangle is skipped, so that other programs can be given the very same work:
 * --dump writes PREFIX.camera, PREFIX.bounce and PREFIX.segment. Such a file is little endian: the eight bytes MLTRAYS1, the number of
 * triangles and that of rays (uint32 each), nine floats for each triangle (its three corners), and eight for each ray: origin (3), least t (0),
 * direction (3), greatest t. Reports only; asserts nothing. */
#include "../bvh.h"
#include "../obj.h"
#include "../rng.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct { float (*position)[3]; uint32_t n, space; Vec3 eye, look; } Soup;   /* triangle i has the corners 3i, 3i + 1, 3i + 2 */
typedef struct { float origin[3], t_min, direction[3], t_max; } DumpRay;
enum { CAMERA, BOUNCE, SEGMENT, KINDS };
static const char *const kind_name[KINDS] = { "camera", "bounce", "segment" };
static const double OFFSET = 1e-5;     /* of ray ends from their surfaces */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *must(void *p)
{
    if (p) return p;
    fprintf(stderr, "bench_rays: out of memory\n");
    exit(1);
}

/* ---- scenes ---- */

static void put(Soup *s, Vec3 a, Vec3 b, Vec3 c)
{
    if (s->n == s->space) s->position = must(realloc(s->position, sizeof *s->position * 3 * (s->space = s->space * 2 + 1024)));
    Vec3 p[3] = { a, b, c };
    for (int k = 0; k < 3; k++) {
        float *f = s->position[3 * (size_t)s->n + (size_t)k];
        f[0] = (float)p[k].x; f[1] = (float)p[k].y; f[2] = (float)p[k].z;
    }
    s->n++;
}

/* The parallelogram corner, corner + u, corner + u + v, corner + v in m by n cells. */
static void put_sheet(Soup *s, Vec3 corner, Vec3 u, Vec3 v, int m, int n)
{
    for (int i = 0; i < m; i++)
        for (int j = 0; j < n; j++) {
            Vec3 p[4];
            for (int k = 0; k < 4; k++) p[k] = along(along(corner, (double)(i + (k == 1 || k == 2)) / m, u), (double)(j + k / 2) / n, v);
            put(s, p[0], p[1], p[2]);
            put(s, p[0], p[2], p[3]);
        }
}

static void put_block(Soup *s, Vec3 corner, Vec3 u, Vec3 v, Vec3 w)
{
    Vec3 far = add(corner, add(u, add(v, w)));
    put_sheet(s, corner, u, v, 1, 1); put_sheet(s, corner, v, w, 1, 1); put_sheet(s, corner, w, u, 1, 1);
    put_sheet(s, far, neg(u), neg(v), 1, 1); put_sheet(s, far, neg(v), neg(w), 1, 1); put_sheet(s, far, neg(w), neg(u), 1, 1);
}

static Vec3 bumpy(double radius, double bump, double theta, double phi)
{
    double r = radius * (1 + bump * sin(17 * theta) * cos(19 * phi) + 0.3 * bump * sin(61 * theta + 53 * phi));
    return vec3(r * sin(theta) * cos(phi), r * cos(theta), r * sin(theta) * sin(phi));
}

static void put_sphere(Soup *s, Vec3 centre, double radius, double bump, int rows)
{
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < 2 * rows; j++) {
            Vec3 p[4];
            for (int k = 0; k < 4; k++)
                p[k] = add(centre, bumpy(radius, bump, PI * (i + k / 2) / rows, PI * ((j + (k == 1 || k == 2)) % (2 * rows)) / rows));
            if (i) put(s, p[0], p[1], p[2]);
            if (i + 1 < rows) put(s, p[0], p[2], p[3]);
        }
}

static void put_walls(Soup *s, Vec3 low, Vec3 high)
{
    Vec3 d = sub(high, low);
    put_block(s, low, vec3(d.x, 0, 0), vec3(0, d.y, 0), vec3(0, 0, d.z));
}

static void make_sphere(Soup *s, double share)
{
    put_sphere(s, vec3(0, 0, 0), 0.8, 0.05, (int)(500 * sqrt(share)));
    s->eye = vec3(0.1, 0.05, -0.2);
    s->look = vec3(1, 0.3, 1);
}

/* Shelves of bumpy balls. */
static void make_room(Soup *s, double share)
{
    put_walls(s, vec3(-1, -0.6, -1), vec3(1, 0.6, 1));
    int rows = (int)(50 * sqrt(share)) + 2;
    for (int i = 0; i < 8; i++)
        for (int j = 0; j < 5; j++) {
            double x = -0.87 + 0.25 * i, y = -0.48 + 0.24 * j;
            put_block(s, vec3(x - 0.1, y - 0.12, -0.9), vec3(0.2, 0, 0), vec3(0, 0.01, 0), vec3(0, 0, 1.2));
            for (int k = 0; k < 10; k++) put_sphere(s, vec3(x + 0.02 * (k % 3), y - 0.04, -0.84 + 0.12 * k), 0.065, 0.15, rows);
        }
    s->eye = vec3(0.05, 0.1, 0.9);
    s->look = vec3(0, 0, 0);
}

static void make_box(Soup *s, double share)
{
    (void)share;
    put_walls(s, vec3(-1, -1, -1), vec3(1, 1, 1));
    put_block(s, vec3(-0.3, 0.98, -0.3), vec3(0.6, 0, 0), vec3(0, 0.01, 0), vec3(0, 0, 0.6));
    put_block(s, vec3(0.1, -1, 0), vec3(0.5, 0, 0.2), vec3(0, 0.6, 0), vec3(-0.2, 0, 0.5));
    put_block(s, vec3(-0.6, -1, -0.5), vec3(0.5, 0, -0.2), vec3(0, 1.2, 0), vec3(0.2, 0, 0.5));
    s->eye = vec3(0, 0, 0.95);
    s->look = vec3(0, -0.1, 0);
}

/* Turned tables and slatted chairs: long thin triangles that lie across the axes, over a ground of two. */
static void make_furniture(Soup *s, double share)
{
    put_walls(s, vec3(-1, -0.4, -1), vec3(1, 0.4, 1));
    Rng rng = rng_new(7, 1);
    int n = (int)(1200 * share) + 1;
    for (int i = 0; i < n; i++) {
        double angle = 2 * PI * rng_double(&rng), size = 0.6 / sqrt(n) * (1 + rng_double(&rng));
        Vec3 u = vec3(cos(angle), 0, sin(angle)), v = vec3(-sin(angle), 0, cos(angle)), y = vec3(0, 1, 0);
        Vec3 at = vec3(1.8 * rng_double(&rng) - 0.9, -0.4, 1.8 * rng_double(&rng) - 0.9);
        for (int leg = 0; leg < 4; leg++)
            put_block(s, along(along(at, size * (leg % 2), u), size * (leg / 2), v), scale(0.06 * size, u), scale(size, y), scale(0.06 * size, v));
        for (int slat = 0; slat < 12; slat++)
            put_block(s, along(along(at, size, y), size * slat / 12, u), scale(0.06 * size, u), scale(0.03 * size, y), scale(1.1 * size, v));
        for (int slat = 0; slat < 8; slat++)
            put_block(s, along(at, size * (1 + 0.1 * slat), y), scale(1.05 * size, u), scale(0.04 * size, add(y, scale(0.3, v))), scale(0.03 * size, v));
        put_sphere(s, along(along(along(at, 1.15 * size, y), 0.5 * size, u), 0.5 * size, v), 0.12 * size, 0.1, 10);
    }
    s->eye = vec3(0, 0.25, 0.95);
    s->look = vec3(0, -0.3, 0);
}

static bool read_obj(Soup *s, const char *path)
{
    Mesh mesh;
    Report report;
    memset(&report, 0, sizeof report);
    if (!obj_read(&mesh, path, &report)) return false;
    for (uint32_t i = 0; i < mesh.n_triangles; i++) {
        Vec3 p[3];
        for (int k = 0; k < 3; k++) p[k] = from_float(mesh.position[mesh.triangle[i][k]]);
        put(s, p[0], p[1], p[2]);
    }
    mesh_free(&mesh);
    s->eye = vec3(1, 0.8, 2);
    s->look = vec3(0, 0, 0);
    return true;
}

/* ---- rays ---- */

static Vec3 corner(const Soup *s, uint32_t triangle, uint32_t k) { return from_float(s->position[3 * (size_t)triangle + k]); }

/* The point of a hit, and the surface's normal on the side that the ray came from. */
static Vec3 surface_at(const Soup *s, const Hit *hit, Vec3 direction, Vec3 *normal)
{
    Vec3 a = corner(s, hit->triangle, 0), b = corner(s, hit->triangle, 1), c = corner(s, hit->triangle, 2);
    Vec3 n = cross(sub(b, a), sub(c, a));
    *normal = scale((dot(n, direction) > 0 ? -1 : 1) / length(n), n);
    return along(along(a, hit->u, sub(b, a)), hit->v, sub(c, a));
}

static void record(DumpRay *ray, Vec3 o, Vec3 d, double t_max)
{
    *ray = (DumpRay){ { (float)o.x, (float)o.y, (float)o.z }, 0, { (float)d.x, (float)d.y, (float)d.z }, (float)t_max };
}

static Ray to_ray(const DumpRay *r)
{
    return (Ray){ from_float(r->origin), from_float(r->direction), (double)r->t_max, { BVH_NONE, BVH_NONE } };
}

/* Paths from the camera of up to eight vertices, until there are n rays of each kind. */
static void make_rays(const Soup *s, const Bvh *bvh, DumpRay *ray[KINDS], uint32_t n)
{
    Rng rng = rng_new(1, 2);
    Vec3 right, up, forward = normalize(sub(s->look, s->eye)), last = s->eye;
    frame(forward, &right, &up);
    uint32_t made[KINDS] = { 0 };
    for (uint32_t paths = 0; made[CAMERA] < n || made[BOUNCE] < n || made[SEGMENT] < n; paths++) {
        if (paths > 100 * n) { fprintf(stderr, "bench_rays: the camera sees nothing\n"); exit(1); }
        Vec3 o = s->eye, d = along(along(forward, 1.2 * rng_double(&rng) - 0.6, right), 1.2 * rng_double(&rng) - 0.6, up), normal, fresh = last;
        for (int depth = 0; depth < 8; depth++) {
            DumpRay r;
            record(&r, o, d, 1e30);
            uint32_t *m = &made[depth ? BOUNCE : CAMERA];
            if (*m < n) ray[depth ? BOUNCE : CAMERA][(*m)++] = r;
            Ray query = to_ray(&r);
            Hit hit;
            if (!bvh_closest(bvh, &query, &hit)) break;
            Vec3 p = surface_at(s, &hit, d, &normal);
            o = along(p, OFFSET, normal);
            if (made[SEGMENT] < n) record(&ray[SEGMENT][made[SEGMENT]++], o, sub(last, o), 1);
            if (!depth || rng_double(&rng) < 0.3) fresh = o;
            double r2 = rng_double(&rng), phi = 2 * PI * rng_double(&rng);
            Vec3 a, b;
            frame(normal, &a, &b);
            d = add(add(scale(sqrt(r2) * cos(phi), a), scale(sqrt(r2) * sin(phi), b)), scale(sqrt(1 - r2), normal));
        }
        last = fresh;
    }
}

static void dump(const Soup *s, const DumpRay *ray, uint32_t n, const char *prefix, const char *scene, const char *kind)
{
    char path[1024];
    snprintf(path, sizeof path, "%s%s.%s", prefix, scene, kind);
    FILE *f = fopen(path, "wb");
    uint32_t count[2] = { s->n, n };
    if (!f || fwrite("MLTRAYS1", 1, 8, f) != 8 || fwrite(count, 4, 2, f) != 2 || fwrite(s->position, 36, s->n, f) != s->n
        || fwrite(ray, sizeof *ray, n, f) != n || fclose(f)) {
        perror(path);
        exit(1);
    }
}

/* ---- timing ---- */

static int by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median million rays a second. */
static double time_queries(const Bvh *bvh, const DumpRay *ray, uint32_t n, bool any, int repeats, uint32_t *hits)
{
    double rate[100];
    for (int k = 0; k < repeats; k++) {
        *hits = 0;
        double start = now();
        for (uint32_t i = 0; i < n; i++) {
            Ray r = to_ray(&ray[i]);
            Hit hit;
            *hits += any ? bvh_any(bvh, &r) : bvh_closest(bvh, &r, &hit);
        }
        rate[k] = 1e-6 * n / (now() - start);
    }
    qsort(rate, (size_t)repeats, sizeof *rate, by_value);
    return rate[repeats / 2];
}

static void bench(const Soup *s, const char *name, uint32_t n_rays, int repeats, const char *dump_prefix)
{
    uint32_t (*triangle)[3] = must(malloc(sizeof *triangle * s->n));
    for (uint32_t i = 0; i < s->n; i++)
        for (uint32_t k = 0; k < 3; k++) triangle[i][k] = 3 * i + k;
    DumpRay *ray[KINDS];
    for (int k = 0; k < KINDS; k++) ray[k] = must(calloc(n_rays, sizeof **ray));
    static const char *const effort_name[2] = { "fast", "best" };
    for (int effort = 0; effort < 2; effort++) {
        double start = now();
        Bvh *bvh = must(bvh_new((const float (*)[3])s->position, (const uint32_t (*)[3])triangle, s->n, effort ? BVH_BEST : BVH_FAST));
        double seconds = now() - start;
        printf("%-12s %8u triangles, %s: built in %.3f s, %.1f bytes a triangle\n", name, s->n, effort_name[effort], seconds,
               (double)bvh_bytes(bvh) / s->n);
        if (!effort) make_rays(s, bvh, ray, n_rays);
        for (int k = 0; k < KINDS; k++) {
            uint32_t hits[2];
            double closest = time_queries(bvh, ray[k], n_rays, false, repeats, &hits[0]);
            double any = time_queries(bvh, ray[k], n_rays, true, repeats, &hits[1]);
            printf("    %-8s closest %7.3f Mrays/s (%u hits)   any %7.3f Mrays/s (%u hits)\n", kind_name[k], closest, hits[0], any, hits[1]);
            if (dump_prefix && !effort) dump(s, ray[k], n_rays, dump_prefix, name, kind_name[k]);
        }
        fflush(stdout);
        bvh_free(bvh);
    }
    for (int k = 0; k < KINDS; k++) free(ray[k]);
    free(triangle);
}

int main(int argc, char **argv)
{
    static const struct { const char *name; void (*make)(Soup *, double); } scene[] = {
        { "sphere", make_sphere }, { "room", make_room }, { "box", make_box }, { "furniture", make_furniture } };
    enum { SCENES = sizeof scene / sizeof *scene };
    double share = 1;
    uint32_t n_rays = 500000;
    int repeats = 5;
    const char *dump_prefix = NULL;
    bool named = false;
    for (int i = 1; i <= argc; i++) {
        if (i < argc && argv[i][0] == '-') {
            const char *value = i + 1 < argc ? argv[i + 1] : "";
            if (!strcmp(argv[i], "--size")) share = strtod(value, NULL);
            else if (!strcmp(argv[i], "--rays")) n_rays = (uint32_t)strtoul(value, NULL, 10);
            else if (!strcmp(argv[i], "--repeats")) repeats = atoi(value);
            else if (!strcmp(argv[i], "--dump")) dump_prefix = value;
            else share = 0;
            if (!(share > 0) || n_rays < 1 || repeats < 1 || repeats > 100 || !*value) {
                fprintf(stderr, "usage: bench_rays [--size SHARE] [--rays N] [--repeats N] [--dump PREFIX] [sphere | room | box | furniture | FILE.obj] ...\n");
                return 2;
            }
            i++;
            continue;
        }
        if (i == argc && named) break;
        named = true;
        bool known = false;
        for (int k = 0; k < SCENES; k++) {
            if (i < argc && strcmp(argv[i], scene[k].name)) continue;
            Soup s = { 0 };
            scene[k].make(&s, share);
            bench(&s, scene[k].name, n_rays, repeats, dump_prefix);
            free(s.position);
            known = true;
        }
        if (known) continue;
        Soup s = { 0 };
        const char *slash = strrchr(argv[i], '/');
        if (!read_obj(&s, argv[i])) { fprintf(stderr, "bench_rays: cannot read %s\n", argv[i]); return 1; }
        bench(&s, slash ? slash + 1 : argv[i], n_rays, repeats, dump_prefix);
        free(s.position);
    }
    return 0;
}
