/* Densities over the directions in which light leaves. See emission.h. */
#include "emission.h"
#include "bsdf.h"
#include <stdlib.h>

enum { LEAF = 16, DEEPEST = 24 };  /* directions that a cell must have to be halved; halvings */
static const double BY_COSINE = 0.5;   /* of all directions so many go by the cosine law, whatever was found: none is missed */
static const double WORTH = 4;         /* how often more, a geometric mean over what was found, directions have to be drawn where they matter */

static void unroll(Vec3 w, double at[2])
{
    double turns = atan2(w.y, w.x) / (2 * PI);
    at[0] = fmin(fmax((1 + w.z) / 2, 0), 0x1.fffffep-1);
    at[1] = fmin(turns < 0 ? turns + 1 : turns, 0x1.fffffep-1);
}

/* The tree's density is that over the square, over 4 pi; the cosine law's cosine / pi. */
static double ratio_at(const Emission *e, uint32_t root, const float at[2], double cosine)
{
    double density = 1;
    float low[2] = { 0, 0 }, size[2] = { 1, 1 };
    int side = 0;
    for (const EmissionNode *node = &e->node[root]; node->child > 0; side = 1 - side) {
        size[side] /= 2;
        bool upper = at[side] >= low[side] + size[side];
        density *= 2 * (upper ? 1 - (double)node->first : (double)node->first);
        if (upper) low[side] += size[side];
        node = &e->node[node->child + upper];
    }
    return BY_COSINE + (1 - BY_COSINE) * density / (4 * cosine);
}

void emission_see(Emission *e, uint32_t material, Vec3 w, double cosine)
{
    uint32_t i = 0;
    double at[2];
    if (e->stride == 0) e->stride = 1;
    if (w.x == e->last.x && w.y == e->last.y && w.z == e->last.z) return;
    e->last = w;
    if (e->told++ % e->stride != 0) return;
    while (i < e->lamps && e->lamp[i].material != material) i++;
    if (i == EMISSION_LAMPS) return;
    if (i == e->lamps) {
        e->lamp[i].material = material;
        e->lamps++;
    }
    if (e->kept == EMISSION_KEPT) {
        for (e->kept = 0; e->kept < EMISSION_KEPT / 2; e->kept++) e->seen[e->kept] = e->seen[2 * e->kept];
        e->stride *= 2;
    }
    unroll(w, at);
    e->seen[e->kept++] = (EmissionSeen){ { (float)at[0], (float)at[1] }, (float)cosine, i };
}

static void swap(EmissionSeen *a, EmissionSeen *b) { EmissionSeen was = *a; *a = *b; *b = was; }

/* Those of a lamp come first, from 'from' on; returns where they end. */
static uint32_t gather(Emission *e, uint32_t from, uint32_t lamp)
{
    for (uint32_t i = from; i < e->kept; i++)
        if (e->seen[i].lamp == lamp) swap(&e->seen[from++], &e->seen[i]);
    return from;
}

/* The directions seen[from .. to - 1] that are in a node's cell, whose lower corner is 'low'. */
typedef struct { uint32_t from, to; int depth; float low[2]; } Cell;

/* A cell is halved from left to right, then from below to above. */
static float middle_of(const Cell *c) { return c->low[c->depth % 2] + ldexpf(0.5f, -(c->depth / 2)); }

static void halve(Emission *e, EmissionNode *node, const Cell *cell, Cell child[2])
{
    int side = cell->depth % 2;
    float middle = middle_of(cell);
    uint32_t upper = cell->from, end = cell->to;
    while (upper < end) {
        if (e->seen[upper].at[side] < middle) upper++;
        else swap(&e->seen[upper], &e->seen[--end]);
    }
    *node = (EmissionNode){ (float)(upper - cell->from) / (float)(cell->to - cell->from), e->nodes };
    child[0] = child[1] = *cell;
    child[0].depth = child[1].depth = cell->depth + 1;
    child[0].to = child[1].from = upper;
    child[1].low[side] = middle;
}

/* Level by level, so that none of it grows at the cost of the rest. False if memory runs out. */
static bool grow(Emission *e, uint32_t root, uint32_t from, uint32_t to)
{
    Cell *cell = malloc(EMISSION_NODES * sizeof *cell);
    if (!cell) return false;
    cell[root] = (Cell){ from, to, 0, { 0, 0 } };
    e->nodes = root + 1;
    for (uint32_t i = root; i < e->nodes; i++) {
        e->node[i] = (EmissionNode){ 0, 0 };
        if (cell[i].to - cell[i].from < LEAF || cell[i].depth == DEEPEST || e->nodes + 2 > EMISSION_NODES) continue;
        halve(e, &e->node[i], &cell[i], &cell[e->nodes]);
        e->nodes += 2;
    }
    free(cell);
    return true;
}

/* The geometric mean of emission_ratio over what was found. */
static double gain(const Emission *e, uint32_t root, uint32_t from, uint32_t to)
{
    double sum = 0;
    for (uint32_t i = from; i < to; i++) sum += log(ratio_at(e, root, e->seen[i].at, (double)e->seen[i].cosine));
    return exp(sum / (double)(to - from));
}

void emission_learn(Emission *e)
{
    e->nodes = 1;                              /* 0 is no root */
    for (uint32_t i = 0, from = 0, to; i < e->lamps; i++, from = to) {
        uint32_t root = e->nodes;
        to = gather(e, from, i);
        e->lamp[i].root = root < EMISSION_NODES && to - from >= LEAF && grow(e, root, from, to) && gain(e, root, from, to) > WORTH ? root : 0;
        if (e->lamp[i].root == 0) e->nodes = root;
    }
}

Vec3 emission_sample(const Emission *e, uint32_t root, Vec3 n, Rng *rng)
{
    if (rng_double(rng) < BY_COSINE) return sample_cosine(n, rng);
    double u = rng_double(rng), low[2] = { 0, 0 }, size[2] = { 1, 1 };
    int side = 0;
    for (const EmissionNode *node = &e->node[root]; node->child > 0; side = 1 - side) {
        double first = (double)node->first;
        bool upper = u >= first;
        u = upper ? (u - first) / (1 - first) : u / first;
        size[side] /= 2;
        if (upper) low[side] += size[side];
        node = &e->node[node->child + upper];
    }
    double z = 2 * (low[0] + size[0] * u) - 1, phi = 2 * PI * (low[1] + size[1] * rng_double(rng)), r = sqrt(larger(0, 1 - z * z));
    return vec3(r * cos(phi), r * sin(phi), z);
}

double emission_ratio(const Emission *e, uint32_t root, Vec3 w, double cosine)
{
    double at[2];
    unroll(w, at);
    float rounded[2] = { (float)at[0], (float)at[1] };
    return ratio_at(e, root, rounded, cosine);
}
