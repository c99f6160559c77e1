/* Building the tree: binary by the binned surface area heuristic, with spatial splits if it shall be the best, then collapsed to nodes of
 * eight children.
 *
 * Sources: Wald, On fast construction of SAH-based bounding volume hierarchies (binning); Stich, Friedrich, Dietrich, Spatial splits in
 * bounding volume hierarchies; Ylitie, Karras, Laine, Efficient incoherent ray traversal on GPUs through compressed wide BVHs (the best
 * collapse).
 *
 * Must not know: rays; materials, paths, meshes beyond vertices and indices. */
#include "bvh_box.h"
#include "bvh_tree.h"
#include "cache.h"
#include <assert.h>
#include <stdlib.h>
#include <string.h>

/* A triangle, or the part of one in a box. The floats to spare hold the triangle's number and its surface, with the sign turned. */
typedef struct { float bound[8]; } Part;

static inline uint32_t part_id(const Part *p) { uint32_t id; memcpy(&id, &p->bound[3], sizeof id); return id; }
static inline float part_surface(const Part *p) { return -p->bound[7]; }
static inline Box part_box(const Part *p) { return box_load(p->bound); }
static inline void part_shrink(Part *p, Box b)
{
    float bound[8];
    box_store(bound, b);
    for (int a = 0; a < 3; a++) { p->bound[a] = bound[a]; p->bound[a + 4] = bound[a + 4]; }
}

/* Twice the centre: so it is called below. */
static inline Quad part_centre(const Part *p) { return q_sub(q_load(p->bound), q_load(p->bound + 4)); }

/* A node of the binary tree: children left and left + 1 or, if left is 0, a leaf of the parts first .. first + count - 1. */
typedef struct {
    float bound[8];                    /* a Box; surface of the triangles within in the first float to spare */
    uint32_t left, first, count;
    uint32_t shares;                   /* four bits for each number of slots, see weigh */
} Twig;

static inline Box twig_box(const Twig *t) { return box_load(t->bound); }

typedef struct {
    const float (*position)[3];
    const uint32_t (*triangle)[3];
    Part *part;
    uint32_t *id;                      /* of the parts, once nothing else of them is needed */
    Twig *twig;
    uint32_t n_twigs;
    float root_area;                   /* half the surface of the mesh's box */
    bool split_leaves;                 /* divide groups whose triangles lie apart */
    unsigned char *tree;
    size_t used;                       /* in units */
} Builder;

enum { BINS = 16 };

/* Bins over a box: bin = (x - base) * scale, per axis. An axis along which the box has no length, or is not to be cut, has step 0. */
typedef struct { float base[4], scale[4], step[4]; int bins; } Grid;

static Grid grid_over(Box box, int bins)
{
    Grid g = { .bins = bins };
    float extent[4];
    q_store(g.base, box_low(box));
    box_sides(extent, box);
    for (int a = 0; a < 3; a++)
        if (extent[a] > 1e-30f && extent[a] < 1e30f) {
            g.scale[a] = (float)bins * 0.9999f / extent[a];
            g.step[a] = 1 / g.scale[a];
        }
    return g;
}

/* To be cut across one axis only. */
static Grid grid_along(int axis, Box box)
{
    Grid g = grid_over(box, BINS);
    for (int a = 0; a < 3; a++) if (a != axis) g.step[a] = 0;
    return g;
}

/* The bins as fractions; what is binned by them and divided by them falls on the same side. */
static inline Quad grid_places(const Grid *g, Quad x) { return q_mul(q_sub(x, q_load(g->base)), q_load(g->scale)); }

static inline void grid_bins(const Grid *g, Quad x, int bin[4])
{
    q_truncate(bin, q_min(q_max(grid_places(g, x), q_set(0)), q_set((float)(g->bins - 1))));
}

static inline int grid_bin(const Grid *g, int axis, float x)
{
    return (int)least(greatest((x - g->base[axis]) * g->scale[axis], 0), (float)(g->bins - 1));
}

static float grid_side(const Grid *g, int axis, int bin) { return g->base[axis] + (float)bin * g->step[axis]; }

static uint32_t groups_of(uint32_t n) { return (n + GROUP - 1) / GROUP; }

/* The best plane between bins by the surface area heuristic, which counts groups. axis < 0: none. */
typedef struct { float cost; int axis, bin; Box left, right; uint32_t n_left, n_right; } Plane;

static Plane best_plane(Box box[3][BINS], uint32_t enter[3][BINS], uint32_t leave[3][BINS], const Grid *g)
{
    Plane best = { .cost = INFINITY, .axis = -1 };
    for (int a = 0; a < 3; a++) {
        if (g->step[a] <= 0) continue;
        Box left = box_empty(), right = left;
        float cost_right[BINS];
        uint32_t n_left = 0, n_right = 0;
        for (int b = g->bins - 1; b > 0; b--) {
            right = box_join(right, box[a][b]);
            n_right += leave[a][b];
            cost_right[b] = box_area(right) * (float)groups_of(n_right);
        }
        for (int b = 1; b < g->bins; b++) {
            left = box_join(left, box[a][b - 1]);
            n_left += enter[a][b - 1];
            float cost = box_area(left) * (float)groups_of(n_left) + cost_right[b];    /* not a number if a side is empty */
            if (cost < best.cost) { best.cost = cost; best.axis = a; best.bin = b; }
        }
    }
    if (best.axis < 0) return best;
    best.left = best.right = box_empty();
    for (int b = 0; b < g->bins; b++)
        if (b < best.bin) {
            best.left = box_join(best.left, box[best.axis][b]);
            best.n_left += enter[best.axis][b];
        } else {
            best.right = box_join(best.right, box[best.axis][b]);
            best.n_right += leave[best.axis][b];
        }
    return best;
}

static Plane object_plane(const Part *part, uint32_t n, const Grid *g)
{
    Box box[3][BINS];
    uint32_t count[3][BINS] = { { 0 } };
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < g->bins; b++) box[a][b] = box_empty();
    for (uint32_t i = 0; i < n; i++) {
        int b[4];
        grid_bins(g, part_centre(&part[i]), b);
        for (int a = 0; a < 3; a++) {
            box[a][b[a]] = box_join(box[a][b[a]], part_box(&part[i]));
            count[a][b[a]]++;
        }
    }
    return best_plane(box, count, count, g);
}

/* What is around some parts, and around their centres. */
typedef struct { Box box, centres; } Extent;

static Extent extent_of(const Part *part, uint32_t n)
{
    Extent e = { box_empty(), box_empty() };
    for (uint32_t i = 0; i < n; i++) {
        e.box = box_join(e.box, part_box(&part[i]));
        e.centres = box_join(e.centres, box_point(part_centre(&part[i])));
    }
    return e;
}

/* Reorders the parts and returns how many are on the first side. Without branches, which could not be predicted. */
static uint32_t divide(Part *part, uint32_t n, const Grid *g, const Plane *plane, Extent side[2])
{
    const Box keep[2] = { box_empty(), box_of(q_set(-INFINITY), q_set(-INFINITY)) };
    Box first = box_empty(), second = first;
    float at = (float)plane->bin, place[4];
    uint32_t left = 0;
    for (uint32_t i = 0; i < n; i++) {
        Box p = part_box(&part[i]), centre = box_point(part_centre(&part[i]));
        q_store(place, grid_places(g, part_centre(&part[i])));
        bool is_left = place[plane->axis] < at;
        first = box_join(first, box_meet(centre, keep[is_left]));
        second = box_join(second, box_meet(centre, keep[!is_left]));
        part[i] = part[left];
        box_store(part[left].bound, p);
        left += is_left;
    }
    assert(left == plane->n_left);
    side[0] = (Extent){ plane->left, first };
    side[1] = (Extent){ plane->right, second };
    return left;
}

/* Cuts a part at n planes across an axis, which lie one behind the other: the boxes of its n + 1 pieces. */
static void cut_part(const Builder *b, const Part *part, int axis, const float *plane, int n, Box *piece)
{
    static const float unit[3][4] = { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } };
    const uint32_t *t = b->triangle[part_id(part)];
    Quad across = q_load(unit[axis]), along = q_sub(q_set(1), across);
    for (int k = 0; k <= n; k++) piece[k] = box_empty();
    for (int i = 0; i < 3; i++) {
        const float *p = b->position[t[i]], *q = b->position[t[(i + 1) % 3]];
        Quad corner = q_point(p), edge = q_sub(q_point(q), corner);
        for (int k = 0; k <= n; k++)
            if ((k == 0 || p[axis] >= plane[k - 1]) && (k == n || p[axis] <= plane[k])) piece[k] = box_join(piece[k], box_point(corner));
        for (int k = 0; k < n; k++) {
            float at = plane[k];
            if ((p[axis] < at) == (q[axis] < at) || p[axis] == at || q[axis] == at) continue;
            Quad point = q_add(corner, q_mul(edge, q_set((at - p[axis]) / (q[axis] - p[axis]))));
            Box box = box_point(q_add(q_mul(point, along), q_mul(q_set(at), across)));     /* on the plane without error */
            piece[k] = box_join(piece[k], box);
            piece[k + 1] = box_join(piece[k + 1], box);
        }
    }
    for (int k = 0; k <= n; k++) piece[k] = box_meet(piece[k], part_box(part));
}

/* The best plane across an axis, the only one of the grid's, if it may cut through parts [Stich et al.]. */
static Plane spatial_plane(const Builder *b, const Part *part, uint32_t n, const Grid *g, int axis)
{
    Box box[3][BINS];
    uint32_t enter[3][BINS] = { { 0 } }, leave[3][BINS] = { { 0 } };
    float side[BINS];
    for (int k = 0; k < g->bins; k++) {
        box[axis][k] = box_empty();
        side[k] = grid_side(g, axis, k);
    }
    for (uint32_t i = 0; i < n; i++) {
        int first = grid_bin(g, axis, part[i].bound[axis]), last = grid_bin(g, axis, -part[i].bound[axis + 4]);
        enter[axis][first]++;
        leave[axis][last]++;
        Box piece[BINS];
        piece[0] = part_box(&part[i]);
        if (first < last) cut_part(b, &part[i], axis, side + first + 1, last - first, piece);
        for (int k = first; k <= last; k++)
            if (box_valid(piece[k - first])) box[axis][k] = box_join(box[axis][k], piece[k - first]);
    }
    return best_plane(box, enter, leave, g);
}

/* Cuts the parts at the plane, unless leaving one whole on one side is cheaper. Pieces are appended: there must be room for them.
 * Returns how many are on the first side; *n grows by the pieces. */
static uint32_t cut(const Builder *b, Part *part, uint32_t *n, uint32_t room, const Grid *g, Plane *plane)
{
    float at = grid_side(g, plane->axis, plane->bin);
    uint32_t left = 0, right = *n, end = *n;
    while (left < right) {
        Part *p = &part[left];
        bool is_left = grid_bin(g, plane->axis, -p->bound[plane->axis + 4]) < plane->bin;
        bool is_right = grid_bin(g, plane->axis, p->bound[plane->axis]) >= plane->bin;
        if (!is_left && !is_right) {
            Box piece[2];
            cut_part(b, p, plane->axis, &at, 1, piece);
            Box all_left = box_join(plane->left, part_box(p)), all_right = box_join(plane->right, part_box(p));
            float area_left = box_area(plane->left), area_right = box_area(plane->right);
            float both = area_left * (float)plane->n_left + area_right * (float)plane->n_right;
            float on_left = box_area(all_left) * (float)plane->n_left + area_right * (float)(plane->n_right - 1);
            float on_right = area_left * (float)(plane->n_left - 1) + box_area(all_right) * (float)plane->n_right;
            if (!box_valid(piece[1]) || (on_left <= both && on_left <= on_right) || (end == room && on_left <= on_right)) {
                is_left = true;
                plane->left = all_left;
                plane->n_right--;
            } else if (!box_valid(piece[0]) || on_right <= both || end == room) {
                is_right = true;
                plane->right = all_right;
                plane->n_left--;
            } else {
                part[end] = *p;
                part_shrink(&part[end++], piece[1]);
                part_shrink(p, piece[0]);
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

/* Moves the parts that are large for the box to the front, and returns how many; 0 unless they are few. A wall among furniture would widen
 * the box of whatever it stood with, and cut to pieces it would lie deep in the tree; on its own it is a child near the root, where rays
 * that only want to know whether they are blocked meet it at once. */
static uint32_t set_walls_apart(Part *part, uint32_t n, Box box)
{
    float large = box_area(box) / 10, bound[8];    /* in a cubic room each wall's two triangles are a sixth */
    box_store(bound, box);
    if (-bound[7] < large) return 0;   /* the largest surface of all */
    uint32_t walls = 0;
    for (uint32_t i = 0; i < n; i++) {
        if (box_area(part_box(&part[i])) < large || part_surface(&part[i]) < large) continue;
        Part swap = part[walls];
        part[walls++] = part[i];
        part[i] = swap;
    }
    return walls <= n / 4 ? walls : 0;
}

/* A twig of few triangles is a group if it becomes one child, even if it could be divided among several. */
static bool is_leaf(const Twig *t) { return t->count <= GROUP; }

/* Least cost if a twig becomes at most k + 1 children of a wide node. */
typedef struct { float slots[WIDTH]; } Cost;

static Cost weigh_leaf(const Twig *t)
{
    Cost cost;
    float area = t->count ? box_area(twig_box(t)) : 0;
    for (int k = 0; k < WIDTH; k++) cost.slots[k] = area;
    return cost;
}

/* Which twigs become the children of which wide nodes, at the least cost [Ylitie, Karras, Laine, Efficient incoherent ray traversal on GPUs
 * through compressed wide BVHs]: of k + 1 slots, the bits from 4k on tell how many, less one, go to the first child; the highest of the four,
 * that k slots are as good. */
static Cost weigh(Twig *t, const Cost *l, const Cost *r)
{
    Cost cost;
    float area = t->count ? box_area(twig_box(t)) : 0;
    for (int k = 1; k < WIDTH; k++) {
        int best = 0;
        for (int i = 1; i < k; i++)
            if (l->slots[i] + r->slots[k - 1 - i] < l->slots[best] + r->slots[k - 1 - best]) best = i;
        cost.slots[k] = l->slots[best] + r->slots[k - 1 - best];
        t->shares |= (uint32_t)best << 4 * k;
    }
    cost.slots[0] = is_leaf(t) ? area : area + cost.slots[WIDTH - 1];
    for (int k = 1; k < WIDTH; k++)
        if (!(cost.slots[k] < cost.slots[k - 1])) {
            cost.slots[k] = cost.slots[k - 1];
            t->shares |= 8u << 4 * k;
        }
    return cost;
}

/* Makes twig[at] the root over part[first .. first + n - 1]; the parts up to first + room are free for pieces. */
static Cost grow(Builder *b, uint32_t at, uint32_t first, uint32_t n, uint32_t room, int depth, Extent extent)
{
    Twig *twig = &b->twig[at];
    Part *part = b->part + first;
    *twig = (Twig){ .first = first, .count = n };
    box_store(twig->bound, extent.box);
    if (n <= GROUP) {
        float surface = 0;
        for (uint32_t i = 0; i < n; i++) surface += part_surface(&part[i]);
        twig->bound[3] = surface;
        if (n < 2 || !b->split_leaves) return weigh_leaf(twig);
        room = n;                      /* the parts stay together, so that weigh may make it a leaf after all */
    }
    /* Halving is enough once what remains would only fit so; it bounds recursion and the stack of the traversal. */
    int levels = 0;
    while (levels < 32 && n >> levels) levels++;
    uint32_t left = n / 2, total = n;
    uint32_t walls = n >= 32 && depth + levels < MAX_DEPTH ? set_walls_apart(part, n, extent.box) : 0;
    Extent side[2];
    bool measured = false;
    if (walls)
        left = walls;
    else if (depth + levels < MAX_DEPTH) {
        Grid grid = grid_over(extent.centres, n < 64 ? BINS / 2 : BINS);
        Plane plane = object_plane(part, n, &grid);
        if (n <= GROUP && !(plane.cost < 0.9f * box_area(extent.box))) return weigh_leaf(twig);
        bool is_cut = false;
        /* Cutting pays only where the two sides would overlap much [Stich et al.]; along the longest axis is enough, at half the time. */
        if (room > n && (plane.axis < 0 || box_overlap(plane.left, plane.right) > b->root_area * 1e-3f)) {
            int axis = box_widest(extent.box);
            Grid space = grid_along(axis, extent.box);
            Plane spatial = spatial_plane(b, part, n, &space, axis);
            if (spatial.cost < 0.9f * plane.cost && spatial.n_left < n && spatial.n_right < n) {
                left = cut(b, part, &total, room, &space, &spatial);
                is_cut = true;
            }
        }
        if (!is_cut && plane.axis >= 0) {
            left = divide(part, n, &grid, &plane, side);
            measured = true;
        }
        if (!left || left == total) { left = total / 2; measured = false; }
    }
    uint32_t right = total - left, spare = walls ? 0 : (uint32_t)((double)(room - total) * left / total);
    if (!measured) {
        side[0] = extent_of(part, left);
        side[1] = extent_of(part + left, right);
    }
    if (spare) memmove(part + left + spare, part + left, right * sizeof *part);
    uint32_t child = twig->left = b->n_twigs;
    b->n_twigs += 2;
    Cost l = grow(b, child, first, left, left + spare, depth + 1, side[0]);
    Cost r = grow(b, child + 1, first + left + spare, right, room - left - spare, depth + 1, side[1]);
    twig->bound[3] = b->twig[child].bound[3] + b->twig[child + 1].bound[3];
    return weigh(twig, &l, &r);
}

static void fill_group(const Builder *b, Group *group, const Twig *twig)
{
    memset(group, 0, sizeof *group);
    for (uint32_t i = 0; i < GROUP; i++) {
        group->id[i] = BVH_NONE;
        if (i >= twig->count) continue;
        group->id[i] = b->id[twig->first + i];
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++) group->vertex[k][a][i] = b->position[b->triangle[group->id[i]][k]][a];
    }
}

/* How likely the twig is to block a ray that meets it, by the time it takes to find out: a ray that crosses a convex box meets surface of
 * area S in it S / (half the box's area) times on average. The 2 suits surfaces that stand in clusters, but is only measured. */
static float score(const Twig *t)
{
    float a = t->bound[3] / box_area(twig_box(t));
    return a / (2 + a) / (t->count > GROUP ? 1 + log2f((float)t->count / GROUP) / 2 : 1);
}

static size_t take(Builder *b, size_t bytes)
{
    size_t at = b->used;
    b->used += bytes / UNIT;
    return at;
}

/* The twigs that stand for a twig in k + 1 slots; returns how many they are. */
static int gather(const Builder *b, uint32_t at, int k, uint32_t *pick)
{
    const Twig *t = &b->twig[at];
    while (k > 0 && t->left && t->shares >> 4 * k & 8) k--;
    if (!t->left || k == 0) { *pick = at; return 1; }
    int l = t->shares >> 4 * k & 7, n = gather(b, t->left, l, pick);
    return n + gather(b, t->left + 1, k - 1 - l, pick + n);
}

/* The twigs that become the children of the wide node over one. */
static int gather_children(const Builder *b, uint32_t root, uint32_t pick[WIDTH])
{
    const Twig *t = &b->twig[root];
    pick[0] = root;
    if (!t->left) return 1;
    int l = t->shares >> 4 * (WIDTH - 1) & 7, n = gather(b, t->left, l, pick);
    return n + gather(b, t->left + 1, WIDTH - 2 - l, pick + n);
}

/* The space of the wide node over a twig and of all below, in units. */
static size_t units_of(const Builder *b, uint32_t root)
{
    uint32_t pick[WIDTH];
    int n = gather_children(b, root, pick);
    size_t units = sizeof(Node) / UNIT;
    for (int i = 0; i < n; i++) units += is_leaf(&b->twig[pick[i]]) ? sizeof(Group) / UNIT : units_of(b, pick[i]);
    return units;
}

/* Writes the wide node over a twig, its groups next to it, then the nodes below. */
static Child collapse(Builder *b, uint32_t root)
{
    uint32_t pick[WIDTH];
    int n = gather_children(b, root, pick);
    /* worst blocker first: bvh_any takes children from the last slot on */
    float blocks[WIDTH];
    for (int i = 0; i < n; i++) {
        uint32_t p = pick[i];
        float s = score(&b->twig[p]);
        int k = i;
        for (; k > 0 && blocks[k - 1] > s; k--) { pick[k] = pick[k - 1]; blocks[k] = blocks[k - 1]; }
        pick[k] = p;
        blocks[k] = s;
    }
    size_t place = take(b, sizeof(Node));
    Node *node = (Node *)(void *)(b->tree + place * UNIT);
    for (int i = 0; i < WIDTH; i++) {
        for (int a = 0; a < 3; a++) {
            node->bound[2 * a][i] = i < n ? b->twig[pick[i]].bound[a] : INFINITY;
            node->bound[2 * a + 1][i] = i < n ? -b->twig[pick[i]].bound[a + 4] : -INFINITY;
        }
        node->child[i] = 0;
        if (i >= n || !is_leaf(&b->twig[pick[i]])) continue;
        size_t group = take(b, sizeof(Group));
        node->child[i] = (Child)(group << 1 | 1);
        fill_group(b, (Group *)(void *)(b->tree + group * UNIT), &b->twig[pick[i]]);
    }
    for (int i = 0; i < n; i++)
        if (!is_leaf(&b->twig[pick[i]])) node->child[i] = collapse(b, pick[i]);
    return (Child)(place << 1);
}

/* The whole triangle. */
static Part part_of(const Builder *b, uint32_t id)
{
    const uint32_t *t = b->triangle[id];
    const float *p[3] = { b->position[t[0]], b->position[t[1]], b->position[t[2]] };
    Part part;
    memcpy(&part.bound[3], &id, sizeof id);
    for (int a = 0; a < 3; a++) {
        part.bound[a] = least(p[0][a], least(p[1][a], p[2][a]));
        part.bound[a + 4] = -greatest(p[0][a], greatest(p[1][a], p[2][a]));
    }
    Vec3 corner = from_float(p[0]);
    part.bound[7] = (float)(-0.5 * length(cross(sub(from_float(p[1]), corner), sub(from_float(p[2]), corner))));
    return part;
}

Bvh *bvh_new(const float (*position)[3], const uint32_t (*triangle)[3], uint32_t n, BvhEffort effort)
{
    size_t room = effort == BVH_BEST ? n + (size_t)n / 4 : n;
    if (room > UINT32_MAX / 2 || !n) room = n;
    Bvh *bvh = calloc(1, sizeof *bvh);
    Builder b = { .position = position, .triangle = triangle, .n_twigs = 1 };
    b.part = large_alloc(sizeof *b.part * (room + 1));
    b.twig = large_alloc(sizeof *b.twig * (2 * room + 2));
    if (!bvh || !b.part || !b.twig) goto fail;

    for (uint32_t i = 0; i < n; i++) b.part[i] = part_of(&b, i);
    Extent all = extent_of(b.part, n);
    float bound[8];
    box_store(bound, all.box);
    for (int a = 0; n && a < 3; a++) {
        bvh->low[a] = (double)bound[a];
        bvh->high[a] = -(double)bound[a + 4];
        bvh->reach = fmax(bvh->reach, fmax(fabs(bvh->low[a]), fabs(bvh->high[a])));
    }
    b.split_leaves = effort == BVH_BEST;
    if (n) b.root_area = box_area(all.box);
    grow(&b, 0, 0, n, (uint32_t)room, 0, all);

    /* Of the parts only the numbers are still needed, at the front of their memory: the rest can go to the tree. */
    b.id = (uint32_t *)(void *)b.part;
    for (size_t i = 0; i < room; i++) b.id[i] = part_id(&b.part[i]);
    uint32_t *smaller = realloc(b.id, sizeof *b.id * (room + 1));
    if (smaller) b.id = smaller;
    b.part = NULL;

    bvh->bytes = units_of(&b, 0) * UNIT;
    bvh->allocation = b.tree = large_alloc(bvh->bytes);
    if (!b.tree) goto fail;
    bvh->tree = b.tree;
    bvh->root = collapse(&b, 0);
    free(b.id);
    free(b.twig);
    return bvh;
fail:
    free(b.part);
    free(b.id);
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
