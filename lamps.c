/* Lamps: which of them a path starts at, and which of them to look at from a point. See scene.h.
 *
 * Where many triangles emit, most of them hardly light a given point: they are far, or face away. The lamps stand in a tree whose nodes bound
 * the places and directions of what is below each of up to eight children; a descent goes to one in proportion to what that may at most send to the point,
 * whatever is between. [Conty Estevez and Kulla 2018] One random number serves all the way, so that even ones stay even. What is between may be a wall: now and
 * then a lamp is chosen by its power alone. Whether all that pays is tried out once, in places that paths from the camera come to.
 */
#include "scene.h"
#include <stdlib.h>

enum { WIDE = 8 };

/* What is known of each child: a ball about all corners of its lamps, a cone about all normals, and their power; that is 0 where there is no child. */
typedef struct {
    float x[WIDE], y[WIDE], z[WIDE], radius[WIDE];
    float axis_x[WIDE], axis_y[WIDE], axis_z[WIDE], cos_spread[WIDE], sin_spread[WIDE];
    float power[WIDE];
    uint32_t lamps[WIDE];              /* how many */
    uint32_t child[WIDE];              /* a node; 0 at a single lamp */
} Node;

struct LampTree {
    Node *node;
    uint32_t nodes, room;
    uint32_t *lamp, *place;            /* [n] lamps from left to right, as indices into Scene.light; where each of them stands */
    double *sum;                       /* [n + 1] of the powers of lamps to the left */
};

/* Lamps of a part of space, while the tree is built. */
typedef struct { Vec3 low, high, normals /* times power */; double power; uint32_t n; } Part;
typedef struct { Vec3 corner[3], centroid, normal; Part part; uint32_t light; } Lamp;

/* Alias table (Walker; Vose's construction): one random number picks a light in constant time. On entry light_threshold holds powers. */
static void build_alias(Scene *s, uint32_t *work)
{
    uint32_t n = s->n_lights, n_small = 0, n_large = n;            /* work: small ones from the left, large ones from the right */
    for (uint32_t i = 0; i < n; i++) {
        s->light_threshold[i] *= n / s->power;
        s->light_alias[i] = i;
        if (s->light_threshold[i] < 1) work[n_small++] = i;
        else work[--n_large] = i;
    }
    while (n_small > 0 && n_large < n) {
        uint32_t small = work[--n_small], large = work[n_large];
        s->light_alias[small] = large;
        s->light_threshold[large] -= 1 - s->light_threshold[small];
        if (s->light_threshold[large] < 1) { n_large++; work[n_small++] = large; }
    }
    while (n_small > 0) s->light_threshold[work[--n_small]] = 1;   /* what rounding left over */
}

static void bound(Node *node, int child, const Lamp *lamp, uint32_t n, double whole)
{
    Vec3 centre = vec3(0, 0, 0), axis = centre;
    double power = 0, radius = 0, cosine = 1;
    for (uint32_t i = 0; i < n; i++) {
        power += lamp[i].part.power;
        centre = along(centre, lamp[i].part.power, lamp[i].centroid);
        axis = along(axis, lamp[i].part.power, lamp[i].normal);
    }
    centre = power > 0 ? scale(1 / power, centre) : lamp[0].centroid;
    axis = length(axis) > 1e-3 * power ? normalize(axis) : lamp[0].normal;
    for (uint32_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) radius = larger(radius, length(sub(lamp[i].corner[k], centre)));
        cosine = smaller(cosine, dot(lamp[i].normal, axis));
    }
    cosine = larger(cosine - 1e-6, -1);
    node->x[child] = (float)centre.x; node->y[child] = (float)centre.y; node->z[child] = (float)centre.z;
    node->axis_x[child] = (float)axis.x; node->axis_y[child] = (float)axis.y; node->axis_z[child] = (float)axis.z;
    node->radius[child] = (float)(1.00001 * radius + 1e-7);        /* what single precision loses included */
    node->cos_spread[child] = (float)cosine;
    node->sin_spread[child] = (float)sqrt(1 - cosine * cosine);
    node->power[child] = (float)(power / whole);
    node->lamps[child] = n;
}

static double axis_of(Vec3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

static Vec3 lowest(Vec3 a, Vec3 b) { return vec3(smaller(a.x, b.x), smaller(a.y, b.y), smaller(a.z, b.z)); }
static Vec3 highest(Vec3 a, Vec3 b) { return vec3(larger(a.x, b.x), larger(a.y, b.y), larger(a.z, b.z)); }

static void join(Part *to, const Part *from)
{
    to->low = lowest(to->low, from->low);
    to->high = highest(to->high, from->high);
    to->normals = add(to->normals, from->normals);
    to->power += from->power;
    to->n += from->n;
}

/* Power times extent squared, twice as much where lamps face all ways. */
static double cost(const Part *p)
{
    Vec3 d = sub(p->high, p->low);
    return p->n == 0 ? 0 : p->power * dot(d, d) * (p->power > 0 ? 2 - length(p->normals) / p->power : 2);
}

static const Part EMPTY = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY }, { 0, 0, 0 }, 0, 0 };

static int bin_of(const Lamp *lamp, int axis, Vec3 low, Vec3 width, int bins)
{
    int bin = (int)((axis_of(lamp->centroid, axis) - axis_of(low, axis)) / axis_of(width, axis) * bins);
    return bin < bins ? bin : bins - 1;
}

enum { BINS = 16 };

/* Orders the lamps so that the first of the returned number are apart from the rest: at the best of some planes along each axis. costs[2] receives
 * those of both. */
static uint32_t divide(Lamp *lamp, uint32_t n, double costs[2])
{
    Vec3 low = vec3(INFINITY, INFINITY, INFINITY), high = neg(low);
    Part bin[3][BINS];
    double best = INFINITY;
    int best_axis = 0, best_bin = 0, bins = n < BINS ? (int)n : BINS;
    for (uint32_t i = 0; i < n; i++) {
        low = lowest(low, lamp[i].centroid);
        high = highest(high, lamp[i].centroid);
    }
    Vec3 width = sub(high, low);
    for (int b = 0; b < bins; b++) bin[0][b] = bin[1][b] = bin[2][b] = EMPTY;
    for (uint32_t i = 0; i < n; i++)
        for (int axis = 0; axis < 3; axis++)
            if (axis_of(width, axis) > 0) join(&bin[axis][bin_of(&lamp[i], axis, low, width, bins)], &lamp[i].part);
    costs[0] = costs[1] = 0;
    for (int axis = 0; axis < 3; axis++) {
        Part right[BINS], left = EMPTY;
        right[bins - 1] = bin[axis][bins - 1];
        for (int b = bins - 2; b > 0; b--) { right[b] = right[b + 1]; join(&right[b], &bin[axis][b]); }
        for (int b = 1; b < bins; b++) {
            join(&left, &bin[axis][b - 1]);
            double here = cost(&left), there = cost(&right[b]);
            if (left.n == 0 || right[b].n == 0 || !(here + there < best)) continue;
            best = here + there;
            costs[0] = here;
            costs[1] = there;
            best_axis = axis;
            best_bin = b;
        }
    }
    if (isinf(best)) return n / 2;             /* all in one place */
    uint32_t first = 0;
    for (uint32_t i = 0; i < n; i++)
        if (bin_of(&lamp[i], best_axis, low, width, bins) < best_bin) {
            Lamp swap = lamp[i];
            lamp[i] = lamp[first];
            lamp[first++] = swap;
        }
    return first;
}

static bool build_node(LampTree *tree, Lamp *lamp, uint32_t n, double whole)
{
    if (tree->nodes == tree->room) {
        tree->room = 2 * tree->room + 1;
        Node *more = realloc(tree->node, tree->room * sizeof *more);
        if (!more) return false;
        tree->node = more;
    }
    uint32_t at = tree->nodes++, first[WIDE + 1] = { 0, n };
    double part_cost[WIDE] = { n > 1 ? 0 : -1 };
    int parts = 1;
    for (; parts < WIDE; parts++) {            /* the part that costs most is divided */
        int worst = 0;
        for (int i = 1; i < parts; i++)
            if (part_cost[i] > part_cost[worst]) worst = i;
        if (part_cost[worst] < 0) break;
        double costs[2];
        uint32_t middle = first[worst] + divide(lamp + first[worst], first[worst + 1] - first[worst], costs);
        for (int i = parts; i > worst; i--) { first[i + 1] = first[i]; part_cost[i] = part_cost[i - 1]; }
        first[worst + 1] = middle;
        for (int i = 0; i < 2; i++) part_cost[worst + i] = first[worst + i + 1] - first[worst + i] > 1 ? costs[i] : -1;
    }
    Node node = { .lamps = { 0 } };
    for (int i = 0; i < WIDE; i++) node.radius[i] = 1;             /* where there is none: any but 0 */
    for (int i = 0; i < parts; i++) bound(&node, i, lamp + first[i], first[i + 1] - first[i], whole);
    tree->node[at] = node;
    for (int i = 0; i < parts; i++) {
        if (first[i + 1] - first[i] == 1) continue;
        tree->node[at].child[i] = tree->nodes;
        if (!build_node(tree, lamp + first[i], first[i + 1] - first[i], whole)) return false;
    }
    return true;
}

static const double BY_POWER = 0.1;    /* the share of picks that do not ask the tree */

/* Where light is to arrive, on the side of n. */
typedef struct { float p[3], n[3]; } Receiver;

static inline float root(float square) { return square > 0 ? sqrtf(square) : 0; }

/* A bound of what each child sends to a point, up to a common factor: power over squared distance and the largest cosines at both ends that anything in
 * the ball, and any normal in the cone, may have; inside the ball, as at its rim. Returns the sum. */
static inline float importance(const Node *node, const Receiver *at, float out[WIDE])
{
    for (int i = 0; i < WIDE; i++) {
        float x = node->x[i] - at->p[0], y = node->y[i] - at->p[1], z = node->z[i] - at->p[2], least = node->radius[i] * node->radius[i];
        float squared = x * x + y * y + z * z, inv = 1 / sqrtf(squared), sin_r = node->radius[i] * inv, cos_r = root(1 - sin_r * sin_r);
        float here = (x * at->n[0] + y * at->n[1] + z * at->n[2]) * inv;
        float there = -(x * node->axis_x[i] + y * node->axis_y[i] + z * node->axis_z[i]) * inv, sine = root(1 - there * there);
        /* cosine of the angle less that of the ball, and less that of the cone; 0 if that is below 0 */
        here = here > cos_r ? 1 : here * cos_r + root(1 - here * here) * sin_r;
        float less = there * cos_r + sine * sin_r, rest = sine * cos_r - there * sin_r;
        rest = there > cos_r ? 0 : rest;
        less = there > cos_r ? 1 : less;
        there = less > node->cos_spread[i] ? 1 : less * node->cos_spread[i] + rest * node->sin_spread[i];
        float far = (here > 0 ? here : 0) * (there > 0 ? there : 0) / squared;
        out[i] = node->power[i] * (squared > least ? far : 1 / least);
    }
    return ((out[0] + out[1]) + (out[2] + out[3])) + ((out[4] + out[5]) + (out[6] + out[7]));
}

/* The normal is turned to the side of w. */
static Receiver receiver(const Point *at, Vec3 w)
{
    const Vec3 n = dot(w, at->surface.ng) < 0 ? neg(at->surface.ng) : at->surface.ng;
    return (Receiver){ { (float)at->p.x, (float)at->p.y, (float)at->p.z }, { (float)n.x, (float)n.y, (float)n.z } };
}

/* Whether a child's lamps are so far and so much alike that they are told apart by their power alone. */
static inline bool alike(const Node *node, int i, const Receiver *at)
{
    float x = node->x[i] - at->p[0], y = node->y[i] - at->p[1], z = node->z[i] - at->p[2];
    return node->cos_spread[i] > 0.85f && node->radius[i] * node->radius[i] < 0.02f * (x * x + y * y + z * z);
}

/* The chance of the tree's descent to end at the lamp in that place. */
static double chance_of(const LampTree *tree, const Receiver *at, uint32_t place)
{
    float part[WIDE];
    double p = 1;
    uint32_t first = 0;
    for (const Node *node = tree->node; ; ) {
        double sum = (double)importance(node, at, part);
        int i = 0;
        while (place - first >= node->lamps[i]) first += node->lamps[i++];
        if (!(part[i] > 0)) return 0;
        p *= (double)part[i] / sum;
        if (node->lamps[i] == 1) return p;
        if (alike(node, i, at)) return p * ((tree->sum[place + 1] - tree->sum[place]) / (tree->sum[first + node->lamps[i]] - tree->sum[first]));
        node = &tree->node[node->child[i]];
    }
}

/* The place with sum[place] <= u < sum[place + 1], one of n from the first on. */
static uint32_t find(const double *sum, uint32_t first, uint32_t n, double u)
{
    while (n > 1) {
        uint32_t half = n / 2;
        if (u >= sum[first + half]) { first += half; n -= half; }
        else n = half;
    }
    return first;
}

/* The same where u leads to, 0 <= u < 1; 0 if nothing arrives. */
static double descend(const LampTree *tree, const Receiver *at, double u, uint32_t *place)
{
    float part[WIDE];
    double p = 1;
    uint32_t first = 0;
    for (const Node *node = tree->node; ; ) {
        double sum = (double)importance(node, at, part);
        int chosen = -1;
        uint32_t n = 0, before = 0;
        u *= sum;
        for (int i = 0; i < WIDE; n += node->lamps[i++]) {
            if (!(part[i] > 0)) continue;
            if (chosen >= 0) {
                if (u < (double)part[chosen]) break;
                u -= (double)part[chosen];
            }
            chosen = i;                        /* the last that can be stays if rounding lets the sum end just below */
            before = n;
        }
        if (chosen < 0) return 0;
        *place = first += before;
        n = node->lamps[chosen];
        p *= (double)part[chosen] / sum;
        if (n == 1) return p;
        u = smaller(u / (double)part[chosen], 1 - 0x1p-53);
        if (alike(node, chosen, at)) {
            double low = tree->sum[first], high = tree->sum[first + n];
            *place = find(tree->sum, first, n, low + u * (high - low));
            return p * ((tree->sum[*place + 1] - tree->sum[*place]) / (high - low));
        }
        node = &tree->node[node->child[chosen]];
    }
}

/* By power. */
static uint32_t any_lamp(const Scene *s, double u)
{
    double pick = u * s->n_lights;
    uint32_t i = (uint32_t)pick;
    return pick - i < s->light_threshold[i] ? i : s->light_alias[i];
}

/* Uniform on a lamp. */
static void point_of(const Scene *s, uint32_t lamp, double u, double v, Point *point)
{
    bool fold = u + v > 1;
    scene_triangle_point(s, s->light[lamp], fold ? 1 - u : u, fold ? 1 - v : v, point);
}

void scene_sample_light(const Scene *s, const double random[3], Point *point) { point_of(s, any_lamp(s, random[0]), random[1], random[2], point); }

double scene_light_pdf_a(const Scene *s, const Material *material) { return max3(material->ke) / s->power; }

static double preference(const Scene *s, double chance, const Point *light)
{
    return BY_POWER + (1 - BY_POWER) * chance / (scene_triangle_area(s, light->triangle) * scene_light_pdf_a(s, light->surface.material));
}

double scene_pick_light(const Scene *s, const Point *at, Vec3 w, const double random[3], Point *point)
{
    const LampTree *tree = s->lamp_tree;
    if (!tree) { scene_sample_light(s, random, point); return 1; }
    const Receiver r = receiver(at, w);
    double u = random[0], chance;
    uint32_t lamp, place;
    if (u < BY_POWER) {
        lamp = any_lamp(s, u / BY_POWER);
        chance = chance_of(tree, &r, tree->place[lamp]);
    } else {
        chance = descend(tree, &r, (u - BY_POWER) / (1 - BY_POWER), &place);
        if (!(chance > 0)) return 0;
        lamp = tree->lamp[place];
    }
    point_of(s, lamp, random[1], random[2], point);
    return preference(s, chance, point);
}

double scene_light_preference(const Scene *s, const Point *at, const Point *light)
{
    const LampTree *tree = s->lamp_tree;
    if (!tree) return 1;
    uint32_t low = 0, high = s->n_lights - 1;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (s->light[middle] < light->triangle) low = middle + 1;
        else high = middle;
    }
    const Receiver r = receiver(at, sub(light->p, at->p));
    return preference(s, chance_of(tree, &r, tree->place[low]), light);
}

static void free_tree(Scene *s)
{
    if (!s->lamp_tree) return;
    free(s->lamp_tree->node);
    free(s->lamp_tree->lamp);
    free(s->lamp_tree->place);
    free(s->lamp_tree->sum);
    free(s->lamp_tree);
    s->lamp_tree = NULL;
}

void lamps_free(Scene *s)
{
    free_tree(s);
    free(s->light);
    free(s->light_alias);
    free(s->light_threshold);
}

size_t lamps_bytes(const Scene *s)
{
    return s->n_lights * (size_t)16 + (s->lamp_tree ? s->lamp_tree->nodes * sizeof(Node) + 16 * (size_t)s->n_lights : 0);
}

static bool build_tree(Scene *s, Lamp *lamp)
{
    uint32_t n = s->n_lights;
    LampTree *tree = s->lamp_tree = calloc(1, sizeof *tree);
    if (!tree || !(tree->lamp = malloc(n * sizeof *tree->lamp)) || !(tree->place = malloc(n * sizeof *tree->place))
        || !(tree->sum = malloc((n + (size_t)1) * sizeof *tree->sum)) || !build_node(tree, lamp, n, s->power)) return false;
    Node *fitting = realloc(tree->node, tree->nodes * sizeof *fitting);
    if (fitting) tree->node = fitting;
    tree->sum[0] = 0;
    for (uint32_t i = 0; i < n; i++) {
        tree->lamp[i] = lamp[i].light;
        tree->place[lamp[i].light] = i;
        tree->sum[i + 1] = tree->sum[i] + lamp[i].part.power;
    }
    return true;
}

bool lamps_build(Scene *s)
{
    const Mesh *m = &s->mesh;
    for (uint32_t i = 0; i < m->n_triangles; i++) s->n_lights += material_emits(&m->material[m->triangle_material[i]]);
    if (s->n_lights == 0) return true;
    uint32_t n = s->n_lights, *work = malloc(n * sizeof *work);
    Lamp *lamp = malloc(n * sizeof *lamp);
    s->light = malloc(n * sizeof *s->light);
    s->light_alias = malloc(n * sizeof *s->light_alias);
    s->light_threshold = malloc(n * sizeof *s->light_threshold);
    bool ok = work && lamp && s->light && s->light_alias && s->light_threshold;
    n = 0;
    for (uint32_t i = 0; ok && i < m->n_triangles; i++) {
        const Material *material = &m->material[m->triangle_material[i]];
        if (!material_emits(material)) continue;
        Lamp *l = &lamp[n];
        l->part = (Part){ .low = { INFINITY, INFINITY, INFINITY }, .high = { -INFINITY, -INFINITY, -INFINITY }, .n = 1 };
        for (int k = 0; k < 3; k++) {
            Vec3 c = l->corner[k] = from_float(m->position[m->triangle[i][k]]);
            l->part.low = lowest(l->part.low, c);
            l->part.high = highest(l->part.high, c);
        }
        l->centroid = scale(1.0 / 3, add(l->corner[0], add(l->corner[1], l->corner[2])));
        l->normal = normalize(cross(sub(l->corner[1], l->corner[0]), sub(l->corner[2], l->corner[0])));
        double power = l->part.power = max3(material->ke) * scene_triangle_area(s, i);
        l->part.normals = scale(power, l->normal);
        l->light = n;
        s->light[n] = i;
        s->light_threshold[n++] = power;
        s->power += power;
    }
    if (ok && n > 1) ok = build_tree(s, lamp);
    if (ok) build_alias(s, work);
    free(lamp);
    free(work);
    return ok;
}

/* ---- does the tree pay? ---- */

/* Walks from the camera, edges of each, and samples of light at each vertex. */
enum { WALKS = 64, EDGES = 4, TRIES = 16 };
static const double LEAST_GAIN = 1.15;

/* How much smaller the second moment of light that arrives in a place, on the side of w, is with the tree; 0 if it is dark. */
static double gain_at(const Scene *s, const Point *at, Vec3 w, Rng *rng)
{
    double by_power = 0, by_tree = 0;
    for (int i = 0; i < TRIES; i++) {
        const double u[3] = { rng_double(rng), rng_double(rng), rng_double(rng) };
        Point light;
        scene_sample_light(s, u, &light);
        Vec3 d = sub(light.p, at->p);
        double squared = dot(d, d), here = dot(d, at->surface.ng) * (dot(w, at->surface.ng) < 0 ? -1 : 1), there = -dot(d, light.surface.ng);
        if (!(here > 0 && there > 0) || !scene_visible(s, at, &light)) continue;
        double arrives = here * there / (squared * squared);
        by_power += arrives * arrives;
        by_tree += arrives * arrives / scene_light_preference(s, at, &light);
    }
    return by_tree > 0 ? by_power / by_tree : 0;
}

void lamps_settle(Scene *s)
{
    Rng rng = rng_new(1, 0);
    double sum = 0, n = 0;
    for (int walk = 0; s->lamp_tree && walk < WALKS; walk++) {
        Point at[2];
        Mode mode;
        camera_sample_lens(&s->camera, &rng, &at[0]);
        Vec3 w = camera_direction(&s->camera, &at[0], rng_double(&rng) * s->camera.width, rng_double(&rng) * s->camera.height);
        for (int i = 0; i < EDGES; i++) {
            Point *to = &at[(i + 1) % 2];
            if (!scene_trace(s, &at[i % 2], w, to)) break;
            Vec3 known = neg(w);
            double gain = material_is_specular(to->surface.material) ? 0 : gain_at(s, to, known, &rng);
            if (gain > 0) { sum += log(gain); n++; }
            if (!bsdf_sample(&to->surface, known, &rng, &w, &mode)) break;
        }
    }
    *s->rays = 0;
    if (!(n > 0 && sum / n > log(LEAST_GAIN))) free_tree(s);
}
