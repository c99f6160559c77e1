/* Building the tree: binary by the binned surface area heuristic, with spatial splits if it shall be the best, then collapsed to nodes of
 * eight children.
 *
 * Sources: Wald, On fast construction of SAH-based bounding volume hierarchies (binning); Stich, Friedrich, Dietrich, Spatial splits in
 * bounding volume hierarchies; Ylitie, Karras, Laine, Efficient incoherent ray traversal on GPUs through compressed wide BVHs (the best
 * collapse).
 *
 * Must not know: rays; materials, paths, meshes beyond vertices and indices. */
#ifdef __linux__
#define _DEFAULT_SOURCE                /* for madvise: large pages save the traversal many misses of the address cache */
#include <sys/mman.h>
#endif
#include "bvh_tree.h"
#include <stdlib.h>
#include <string.h>
#ifdef __SSE2__
#include <immintrin.h>
#endif

/* Four floats, of which the box arithmetic uses three. */
#ifdef __SSE2__
typedef __m128 Quad;
static inline Quad q_load(const float *p) { return _mm_loadu_ps(p); }
static inline void q_store(float *p, Quad a) { _mm_storeu_ps(p, a); }
static inline Quad q_set(float f) { return _mm_set1_ps(f); }
static inline Quad q_min(Quad a, Quad b) { return _mm_min_ps(a, b); }
static inline Quad q_max(Quad a, Quad b) { return _mm_max_ps(a, b); }
static inline Quad q_add(Quad a, Quad b) { return _mm_add_ps(a, b); }
static inline Quad q_sub(Quad a, Quad b) { return _mm_sub_ps(a, b); }
static inline Quad q_mul(Quad a, Quad b) { return _mm_mul_ps(a, b); }
#else
typedef struct { float f[4]; } Quad;
static inline Quad q_load(const float *p) { Quad r; memcpy(r.f, p, sizeof r.f); return r; }
static inline void q_store(float *p, Quad a) { memcpy(p, a.f, sizeof a.f); }
static inline Quad q_set(float f) { return (Quad){ { f, f, f, f } }; }
static inline Quad q_min(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] = least(a.f[i], b.f[i]); return a; }
static inline Quad q_max(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] = greatest(a.f[i], b.f[i]); return a; }
static inline Quad q_add(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] += b.f[i]; return a; }
static inline Quad q_sub(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] -= b.f[i]; return a; }
static inline Quad q_mul(Quad a, Quad b) { for (int i = 0; i < 4; i++) a.f[i] *= b.f[i]; return a; }
#endif

typedef struct { Quad low, high; } Box;

static inline Box box_empty(void) { return (Box){ q_set(INFINITY), q_set(-INFINITY) }; }
static inline Box box_join(Box a, Box b) { return (Box){ q_min(a.low, b.low), q_max(a.high, b.high) }; }

/* half the surface area; only of boxes that are not empty */
static inline float box_area(Box b)
{
    float d[4];
    q_store(d, q_sub(b.high, b.low));
    return d[0] * d[1] + d[1] * d[2] + d[2] * d[0];
}

/* A triangle, or the part of one in a box. The fourth float of low holds the triangle's number, that of high is unused. */
typedef struct { float low[4], high[4]; } Part;

static inline uint32_t part_id(const Part *p) { uint32_t id; memcpy(&id, &p->low[3], sizeof id); return id; }
static inline Box part_box(const Part *p) { return (Box){ q_load(p->low), q_load(p->high) }; }
/* Halved before the sum, which cannot overflow then. */
static inline Quad part_centre(const Part *p) { return q_add(q_mul(q_load(p->low), q_set(0.5f)), q_mul(q_load(p->high), q_set(0.5f))); }

/* A node of the binary tree: children left and left + 1 or, if left is 0, a leaf of the parts first .. first + count - 1. */
typedef struct {
    Box box;
    uint32_t left, first, count;
    float surface;                     /* of the triangles within */
    float cost[WIDTH];                 /* cost[k]: least cost if the twig becomes at most k + 1 children of a wide node */
} Twig;

typedef struct {
    const float (*position)[3];
    const uint32_t (*triangle)[3];
    Part *part;
    Twig *twig;
    uint32_t n_twigs;
    float root_area;                   /* half the surface of the mesh's box */
    bool split_leaves;                 /* divide groups whose triangles lie apart */
    unsigned char *tree;               /* NULL while the space is being counted */
    size_t used;                       /* in units */
} Builder;

enum { BINS = 32 };
typedef struct { Box box; uint32_t enter, leave; } Bin;   /* parts whose first, whose last bin this is */

/* Bins over a box: bin = (x - base) * scale, per axis. */
typedef struct { Quad base, scale; float step[4]; int bins; } Grid;

static Grid grid_over(Box box, int bins)
{
    Grid g = { box.low, q_set(0), { 0 }, bins };
    float extent[4], scale[4] = { 0 };
    q_store(extent, q_sub(box.high, box.low));
    for (int a = 0; a < 3; a++)
        if (extent[a] > 1e-30f && extent[a] < 1e30f) {
            scale[a] = (float)bins * 0.9999f / extent[a];
            g.step[a] = 1 / scale[a];
        }
    g.scale = q_load(scale);
    return g;
}

static inline void grid_bins(const Grid *g, Quad x, int bin[4])
{
    float f[4];
    q_store(f, q_min(q_max(q_mul(q_sub(x, g->base), g->scale), q_set(0)), q_set((float)(g->bins - 1))));
    for (int a = 0; a < 3; a++) bin[a] = (int)f[a];
}

static uint32_t groups_of(uint32_t n) { return (n + GROUP - 1) / GROUP; }

/* The best plane between bins by the surface area heuristic, which counts groups. axis < 0: none. */
typedef struct { float cost; int axis, bin; Box left, right; uint32_t n_left, n_right; } Plane;

static Plane best_plane(Bin bins[3][BINS], const Grid *g)
{
    Plane best = { .cost = INFINITY, .axis = -1 };
    for (int a = 0; a < 3; a++) {
        if (g->step[a] <= 0) continue;
        Box right[BINS], left = box_empty();
        uint32_t n_right[BINS], n_left = 0;
        right[g->bins - 1] = bins[a][g->bins - 1].box;
        n_right[g->bins - 1] = bins[a][g->bins - 1].leave;
        for (int b = g->bins - 2; b > 0; b--) {
            right[b] = box_join(right[b + 1], bins[a][b].box);
            n_right[b] = n_right[b + 1] + bins[a][b].leave;
        }
        for (int b = 1; b < g->bins; b++) {
            left = box_join(left, bins[a][b - 1].box);
            n_left += bins[a][b - 1].enter;
            if (!n_left || !n_right[b]) continue;
            float cost = box_area(left) * (float)groups_of(n_left) + box_area(right[b]) * (float)groups_of(n_right[b]);
            if (cost < best.cost) best = (Plane){ cost, a, b, left, right[b], n_left, n_right[b] };
        }
    }
    return best;
}

static Plane object_plane(const Part *part, uint32_t n, const Grid *g)
{
    Bin bins[3][BINS];
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < g->bins; b++) bins[a][b] = (Bin){ box_empty(), 0, 0 };
    for (uint32_t i = 0; i < n; i++) {
        int b[4];
        grid_bins(g, part_centre(&part[i]), b);
        Box box = part_box(&part[i]);
        for (int a = 0; a < 3; a++) {
            Bin *bin = &bins[a][b[a]];
            bin->box = box_join(bin->box, box);
            bin->enter++;
            bin->leave++;
        }
    }
    return best_plane(bins, g);
}

/* Reorders the parts and returns how many are on the first side. */
static uint32_t divide(Part *part, uint32_t n, const Grid *g, const Plane *plane)
{
    uint32_t left = 0, right = n;
    while (left < right) {
        int b[4];
        grid_bins(g, part_centre(&part[left]), b);
        if (b[plane->axis] < plane->bin) { left++; continue; }
        Part swap = part[--right];
        part[right] = part[left];
        part[left] = swap;
    }
    return left;
}

/* The box of that part of the part which lies between two planes across an axis. */
static Box clip(const Builder *b, const Part *part, int axis, float from, float to)
{
    const uint32_t *t = b->triangle[part_id(part)];
    Box box = box_empty();
    for (int k = 0; k < 3; k++) {
        const float *p = b->position[t[k]], *q = b->position[t[(k + 1) % 3]];
        float v[4] = { p[0], p[1], p[2], 0 };
        if (v[axis] >= from && v[axis] <= to) box = box_join(box, (Box){ q_load(v), q_load(v) });
        for (int side = 0; side < 2; side++) {
            float at = side ? to : from;
            if ((p[axis] < at) == (q[axis] < at) || p[axis] == at || q[axis] == at) continue;
            float f = (at - p[axis]) / (q[axis] - p[axis]);
            for (int a = 0; a < 3; a++) v[a] = a == axis ? at : p[a] + f * (q[a] - p[a]);
            box = box_join(box, (Box){ q_load(v), q_load(v) });
        }
    }
    return (Box){ q_max(box.low, q_load(part->low)), q_min(box.high, q_load(part->high)) };
}

static inline bool box_valid(Box b)
{
    float low[4], high[4];
    q_store(low, b.low);
    q_store(high, b.high);
    return low[0] <= high[0] && low[1] <= high[1] && low[2] <= high[2];
}

static float bin_side(const Grid *g, int axis, int bin)
{
    float base[4];
    q_store(base, g->base);
    return base[axis] + (float)bin * g->step[axis];
}

static int widest_axis(Box b)
{
    float d[4];
    q_store(d, q_sub(b.high, b.low));
    return d[0] > d[1] ? (d[0] > d[2] ? 0 : 2) : (d[1] > d[2] ? 1 : 2);
}

/* The best plane if it may cut through parts [Stich et al.]. */
static Plane spatial_plane(const Builder *b, const Part *part, uint32_t n, const Grid *g, int only)
{
    Bin bins[3][BINS];
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < g->bins; k++) bins[a][k] = (Bin){ box_empty(), 0, 0 };
    for (uint32_t i = 0; i < n; i++) {
        int first[4], last[4];
        grid_bins(g, q_load(part[i].low), first);
        grid_bins(g, q_load(part[i].high), last);
        for (int a = only; a <= only; a++) {
            bins[a][first[a]].enter++;
            bins[a][last[a]].leave++;
            for (int k = first[a]; k <= last[a]; k++) {
                Box box = first[a] == last[a] ? part_box(&part[i])
                          : clip(b, &part[i], a, k == first[a] ? -INFINITY : bin_side(g, a, k), k == last[a] ? INFINITY : bin_side(g, a, k + 1));
                if (box_valid(box)) bins[a][k].box = box_join(bins[a][k].box, box);
            }
        }
    }
    return best_plane(bins, g);
}

/* Cuts the parts at the plane, unless leaving one whole on one side is cheaper. Pieces are appended: there must be room for them.
 * Returns how many are on the first side; *n grows by the pieces. */
static uint32_t cut(const Builder *b, Part *part, uint32_t *n, uint32_t room, const Grid *g, Plane *plane)
{
    float at = bin_side(g, plane->axis, plane->bin);
    uint32_t left = 0, right = *n, end = *n;
    while (left < right) {
        Part *p = &part[left];
        int first[4], last[4];
        grid_bins(g, q_load(p->low), first);
        grid_bins(g, q_load(p->high), last);
        bool is_left = last[plane->axis] < plane->bin, is_right = first[plane->axis] >= plane->bin;
        if (!is_left && !is_right) {
            Box l = clip(b, p, plane->axis, -INFINITY, at), r = clip(b, p, plane->axis, at, INFINITY);
            Box all_left = box_join(plane->left, part_box(p)), all_right = box_join(plane->right, part_box(p));
            float area_left = box_area(plane->left), area_right = box_area(plane->right);
            float both = area_left * (float)plane->n_left + area_right * (float)plane->n_right;
            float on_left = box_area(all_left) * (float)plane->n_left + area_right * (float)(plane->n_right - 1);
            float on_right = area_left * (float)(plane->n_left - 1) + box_area(all_right) * (float)plane->n_right;
            if (!box_valid(r) || (on_left <= both && on_left <= on_right) || (end == room && on_left <= on_right)) {
                is_left = true;
                plane->left = all_left;
                plane->n_right--;
            } else if (!box_valid(l) || on_right <= both || end == room) {
                is_right = true;
                plane->right = all_right;
                plane->n_left--;
            } else {
                Part *piece = &part[end++];
                *piece = *p;
                uint32_t id = part_id(p);
                q_store(p->low, l.low); q_store(p->high, l.high);
                q_store(piece->low, r.low); q_store(piece->high, r.high);
                memcpy(&p->low[3], &id, sizeof id);
                memcpy(&piece->low[3], &id, sizeof id);
                is_left = true;
            }
        }
        if (is_left) { left++; continue; }
        Part swap = part[--right];
        part[right] = *p;
        *p = swap;
    }
    *n = end;
    return left;
}

static float overlap(Box a, Box b)
{
    Box both = { q_max(a.low, b.low), q_min(a.high, b.high) };
    return box_valid(both) ? box_area(both) : 0;
}

/* of the whole triangle */
static float part_surface(const Builder *b, const Part *part)
{
    const uint32_t *t = b->triangle[part_id(part)];
    Vec3 p = from_float(b->position[t[0]]);
    return (float)(0.5 * length(cross(sub(from_float(b->position[t[1]]), p), sub(from_float(b->position[t[2]]), p))));
}

/* Moves the parts that are large for the box to the front, and returns how many; 0 unless they are few. A wall among furniture would widen
 * the box of whatever it stood with, and cut to pieces it would lie deep in the tree; on its own it is a child near the root, where rays
 * that only want to know whether they are blocked meet it at once. */
static uint32_t set_walls_apart(const Builder *b, Part *part, uint32_t n, Box box)
{
    float large = box_area(box) / 10;  /* in a cubic room each wall's two triangles are a sixth */
    uint32_t walls = 0;
    for (uint32_t i = 0; i < n; i++) {
        if (box_area(part_box(&part[i])) < large || part_surface(b, &part[i]) < large) continue;
        Part swap = part[walls];
        part[walls++] = part[i];
        part[i] = swap;
    }
    return walls <= n / 4 ? walls : 0;
}

/* Makes twig[at] the root over part[first .. first + n - 1]; the parts up to first + room are free for pieces. */
static void grow(Builder *b, uint32_t at, uint32_t first, uint32_t n, uint32_t room, int depth)
{
    Twig *twig = &b->twig[at];
    Part *part = b->part + first;
    Box box = box_empty(), centres = box_empty();
    for (uint32_t i = 0; i < n; i++) {
        Quad c = part_centre(&part[i]);
        box = box_join(box, part_box(&part[i]));
        centres = box_join(centres, (Box){ c, c });
    }
    *twig = (Twig){ .box = box, .first = first, .count = n };
    if (n <= GROUP) {
        for (uint32_t i = 0; i < n; i++) twig->surface += part_surface(b, &part[i]);
        if (n < 2 || !b->split_leaves) return;
        room = n;                      /* the parts stay together, so that weigh may make it a leaf after all */
    }
    /* Halving is enough once what remains would only fit so; it bounds recursion and the stack of the traversal. */
    int levels = 0;
    while (levels < 32 && n >> levels) levels++;
    uint32_t left = n / 2, total = n;
    uint32_t walls = n >= 32 && depth + levels < MAX_DEPTH ? set_walls_apart(b, part, n, box) : 0;
    if (walls)
        left = walls;
    else if (depth + levels < MAX_DEPTH) {
        Grid grid = grid_over(centres, n < 64 ? 8 : 16);
        Plane plane = object_plane(part, n, &grid);
        if (n <= GROUP && !(plane.cost < 0.9f * box_area(box))) return;
        bool is_cut = false;
        /* Cutting pays only where the two sides would overlap much [Stich et al.]; along the longest axis is enough, at half the time. */
        if (room > n && (plane.axis < 0 || overlap(plane.left, plane.right) > b->root_area * 1e-3f)) {
            Grid space = grid_over(box, 16);
            Plane spatial = spatial_plane(b, part, n, &space, widest_axis(box));
            if (spatial.cost < 0.9f * plane.cost && spatial.n_left < n && spatial.n_right < n) {
                left = cut(b, part, &total, room, &space, &spatial);
                is_cut = true;
            }
        }
        if (!is_cut && plane.axis >= 0) left = divide(part, n, &grid, &plane);
        if (!left || left == total) left = total / 2;
    }
    uint32_t right = total - left, spare = walls ? 0 : (uint32_t)((double)(room - total) * left / total);
    if (spare) memmove(part + left + spare, part + left, right * sizeof *part);
    uint32_t child = twig->left = b->n_twigs;
    b->n_twigs += 2;
    grow(b, child, first, left, left + spare, depth + 1);
    grow(b, child + 1, first + left + spare, right, room - left - spare, depth + 1);
    b->twig[at].surface = b->twig[child].surface + b->twig[child + 1].surface;
}

static void fill_group(const Builder *b, Group *group, const Twig *twig)
{
    memset(group, 0, sizeof *group);
    for (uint32_t i = 0; i < GROUP; i++) {
        group->id[i] = BVH_NONE;
        if (i >= twig->count) continue;
        group->id[i] = part_id(&b->part[twig->first + i]);
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++) group->vertex[k][a][i] = b->position[b->triangle[group->id[i]][k]][a];
    }
}

/* How likely the twig is to block a ray that meets it, by the time it takes to find out: a ray that crosses a convex box meets surface of
 * area S in it S / (half the box's area) times on average. The 2 suits surfaces that stand in clusters, but is only measured. */
static float score(const Twig *t)
{
    float a = t->surface / box_area(t->box);
    return a / (2 + a) / (t->count > GROUP ? 1 + log2f((float)t->count / GROUP) / 2 : 1);
}

static size_t take(Builder *b, size_t bytes)
{
    size_t at = b->used;
    b->used += bytes / UNIT;
    return at;
}

/* A twig of few triangles is a group if it becomes one child, even if it could be divided among several. */
static bool is_leaf(const Twig *t) { return t->count <= GROUP; }

/* The cheapest way to give a twig's two children k + 1 slots in all (k > 0): how many, less one, to the first. */
static int share(const Builder *b, const Twig *t, int k)
{
    const float *l = b->twig[t->left].cost, *r = b->twig[t->left + 1].cost;
    int best = 0;
    for (int i = 1; i < k; i++)
        if (l[i] + r[k - 1 - i] < l[best] + r[k - 1 - best]) best = i;
    return best;
}

/* Which twigs become the children of which wide nodes, at the least cost [Ylitie, Karras, Laine, Efficient incoherent ray traversal on GPUs
 * through compressed wide BVHs]. Twigs come after their parents. */
static void weigh(Builder *b)
{
    for (uint32_t i = b->n_twigs; i-- > 0;) {
        Twig *t = &b->twig[i];
        float area = t->count ? box_area(t->box) : 0;
        if (!t->left) {
            for (int k = 0; k < WIDTH; k++) t->cost[k] = area;
            continue;
        }
        for (int k = WIDTH - 1; k > 0; k--) {
            int l = share(b, t, k);
            t->cost[k] = b->twig[t->left].cost[l] + b->twig[t->left + 1].cost[k - 1 - l];
        }
        t->cost[0] = is_leaf(t) ? area : area + t->cost[WIDTH - 1];
        for (int k = 1; k < WIDTH; k++) if (t->cost[k] > t->cost[k - 1]) t->cost[k] = t->cost[k - 1];
    }
}

/* The twigs that stand for a twig in k + 1 slots; returns how many they are. */
static int gather(const Builder *b, uint32_t at, int k, uint32_t *pick)
{
    const Twig *t = &b->twig[at];
    while (k > 0 && t->left && !(t->cost[k] < t->cost[k - 1])) k--;
    if (!t->left || k == 0) { *pick = at; return 1; }
    int l = share(b, t, k), n = gather(b, t->left, l, pick);
    return n + gather(b, t->left + 1, k - 1 - l, pick + n);
}

/* Writes the wide node over a twig, its groups next to it, then the nodes below; or only counts the space. */
static Child collapse(Builder *b, uint32_t root)
{
    uint32_t pick[WIDTH] = { root };
    int n = 1;
    if (b->twig[root].left) {
        int l = share(b, &b->twig[root], WIDTH - 1);
        n = gather(b, b->twig[root].left, l, pick);
        n += gather(b, b->twig[root].left + 1, WIDTH - 2 - l, pick + n);
    }
    /* worst blocker first: bvh_any takes children from the last slot on */
    for (int i = 1; i < n; i++) {
        uint32_t p = pick[i];
        int k = i;
        for (; k > 0 && score(&b->twig[pick[k - 1]]) > score(&b->twig[p]); k--) pick[k] = pick[k - 1];
        pick[k] = p;
    }
    size_t place = take(b, sizeof(Node));
    Node *node = b->tree ? (Node *)(void *)(b->tree + place * UNIT) : NULL;
    if (node)
        for (int i = 0; i < WIDTH; i++) {
            float low[4] = { INFINITY, INFINITY, INFINITY }, high[4] = { -INFINITY, -INFINITY, -INFINITY };
            if (i < n) { q_store(low, b->twig[pick[i]].box.low); q_store(high, b->twig[pick[i]].box.high); }
            for (int a = 0; a < 3; a++) { node->bound[2 * a][i] = low[a]; node->bound[2 * a + 1][i] = high[a]; }
            node->child[i] = 0;
        }
    for (int i = 0; i < n; i++) {
        const Twig *t = &b->twig[pick[i]];
        if (!is_leaf(t)) continue;
        size_t group = take(b, sizeof(Group));
        if (!node) continue;
        node->child[i] = (Child)(group << 1 | 1);
        fill_group(b, (Group *)(void *)(b->tree + group * UNIT), t);
    }
    for (int i = 0; i < n; i++) {
        if (is_leaf(&b->twig[pick[i]])) continue;
        Child child = collapse(b, pick[i]);
        if (node) node->child[i] = child;
    }
    return (Child)(place << 1);
}

Bvh *bvh_new(const float (*position)[3], const uint32_t (*triangle)[3], uint32_t n, BvhEffort effort)
{
    size_t room = effort == BVH_BEST ? n + (size_t)n / 4 : n;
    if (room > UINT32_MAX / 2 || !n) room = n;
    Bvh *bvh = calloc(1, sizeof *bvh);
    Builder b = { .position = position, .triangle = triangle, .n_twigs = 1 };
    b.part = malloc(sizeof *b.part * (room + 1));
    b.twig = aligned_alloc(sizeof(Quad), sizeof *b.twig * (2 * room + 2));
    if (!bvh || !b.part || !b.twig) goto fail;

    Box all = box_empty();
    for (uint32_t i = 0; i < n; i++) {
        Part p;
        for (int a = 0; a < 3; a++) {
            float f[3] = { position[triangle[i][0]][a], position[triangle[i][1]][a], position[triangle[i][2]][a] };
            p.low[a] = least(f[0], least(f[1], f[2]));
            p.high[a] = greatest(f[0], greatest(f[1], f[2]));
        }
        memcpy(&p.low[3], &i, sizeof i);
        p.high[3] = 0;
        b.part[i] = p;
        all = box_join(all, part_box(&p));
    }
    if (n) {
        float low[4], high[4];
        q_store(low, all.low);
        q_store(high, all.high);
        for (int a = 0; a < 3; a++) {
            bvh->low[a] = (double)low[a];
            bvh->high[a] = (double)high[a];
            bvh->reach = fmax(bvh->reach, fmax(fabs(bvh->low[a]), fabs(bvh->high[a])));
        }
    }
    b.split_leaves = effort == BVH_BEST;
    if (n) b.root_area = box_area(all);
    grow(&b, 0, 0, n, (uint32_t)room, 0);

    weigh(&b);
    collapse(&b, 0);
    bvh->bytes = b.used * UNIT;
    size_t page = bvh->bytes >> 21 ? (size_t)1 << 21 : 64;
    bvh->allocation = b.tree = aligned_alloc(page, (bvh->bytes + page - 1) / page * page);
    if (!b.tree) goto fail;
#ifdef MADV_HUGEPAGE
    if (page > 64) madvise(b.tree, (bvh->bytes + page - 1) / page * page, MADV_HUGEPAGE);
#endif
    b.used = 0;
    bvh->tree = b.tree;
    bvh->root = collapse(&b, 0);
    free(b.part);
    free(b.twig);
    return bvh;
fail:
    free(b.part);
    free(b.twig);
    free(bvh);
    return NULL;
}

void bvh_free(Bvh *bvh)
{
    if (!bvh) return;
    free(bvh->allocation);
    free(bvh);
}

size_t bvh_bytes(const Bvh *bvh) { return sizeof *bvh + bvh->bytes; }
