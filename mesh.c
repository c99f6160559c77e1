/* From the arrays that an OBJ file gives to the Mesh that the renderer uses (scene.h): unit and centre, polygons cut, the front side where the
 * normals see it, nothing without area, nothing that is not used. Must not know the file. */
#include "mesh.h"
#include "polygon.h"
#include <float.h>
#include <stdlib.h>
#include <string.h>

static const char out_of_memory[] = "out of memory";

static bool is_none(const uint32_t triangle[3]) { return triangle[0] == BVH_NONE; }

/* Drops the items that no triangle uses, and renumbers. False if memory runs out. */
static bool drop_unused(void *item, size_t size, uint32_t *n, uint32_t (*triangle)[3], uint32_t n_triangles)
{
    uint32_t kept = 0;
    unsigned char *used = calloc((size_t)*n + 1, 1);
    if (!used) return false;
    for (uint32_t i = 0; i < n_triangles; i++)
        if (!is_none(triangle[i])) used[triangle[i][0]] = used[triangle[i][1]] = used[triangle[i][2]] = 1;
    for (uint32_t i = 0; i < *n; i++) kept += used[i];
    uint32_t *number = NULL;
    if (kept < *n) {
        number = malloc(*n * sizeof *number);
        if (!number) return free(used), false;
        kept = 0;
        for (uint32_t i = 0; i < *n; i++) {
            if (!used[i]) continue;
            memmove((char *)item + kept * size, (char *)item + i * size, size);
            number[i] = kept++;
        }
        for (uint32_t i = 0; i < n_triangles; i++)
            if (!is_none(triangle[i])) mesh_set3(triangle[i], number[triangle[i][0]], number[triangle[i][1]], number[triangle[i][2]]);
        *n = kept;
    }
    free(number);
    free(used);
    return true;
}

/* Finds centre and unit and turns the positions into floats, in their place. Returns what is wrong, or NULL. */
static const char *scale_positions(Mesh *m, double (*position)[3])
{
    double low[3], high[3], centre[3], half = 0;
    memcpy(low, position[0], sizeof low);
    memcpy(high, low, sizeof high);
    for (uint32_t i = 1; i < m->n_positions; i++)
        for (int k = 0; k < 3; k++) {
            double x = position[i][k];
            low[k] = x < low[k] ? x : low[k];
            high[k] = x > high[k] ? x : high[k];
        }
    for (int k = 0; k < 3; k++) {
        centre[k] = low[k] / 2 + high[k] / 2;
        half = fmax(half, fmax(high[k] - centre[k], centre[k] - low[k]));      /* of the rounded centre: no position gets beyond 1 */
    }
    int exponent = 0;
    if (half > 0 && frexp(half, &exponent) == 0.5) exponent--;
    if (exponent < -1000 || exponent > 1000) return half < 1 ? "the scene is too small" : "the scene is too large";
    m->centre = vec3(centre[0], centre[1], centre[2]);
    m->unit = ldexp(1, exponent);
    double per_unit = ldexp(1, -exponent);
    char *bytes = (char *)position;    /* copied as bytes, since doubles and floats share the memory */
    for (uint32_t i = 0; i < m->n_positions; i++) {
        double x[3];
        float f[3];
        memcpy(x, bytes + i * sizeof x, sizeof x);
        for (int k = 0; k < 3; k++) f[k] = (float)((x[k] - centre[k]) * per_unit);
        memcpy(bytes + i * sizeof f, f, sizeof f);
    }
    m->position = (float (*)[3])(void *)bytes;
    return NULL;
}

static void read_fan(uint32_t (*triangle)[3], const MeshPolygon *polygon, uint32_t *corner)
{
    corner[0] = triangle[polygon->first][0];
    corner[1] = triangle[polygon->first][1];
    for (uint32_t i = 2; i < polygon->corners; i++) corner[i] = triangle[polygon->first + i - 2][2];
}

static void write_cut(uint32_t (*triangle)[3], const MeshPolygon *polygon, const uint32_t *corner, uint32_t (*cut)[3])
{
    for (uint32_t i = 0; i + 2 < polygon->corners; i++)
        mesh_set3(triangle[polygon->first + i], corner[cut[i][0]], corner[cut[i][1]], corner[cut[i][2]]);
}

/* Better triangles than fans for the polygons. False if memory runs out. */
static bool cut_polygons(Mesh *m, const MeshPolygon *polygons, uint32_t n)
{
    uint32_t most = 1;
    for (uint32_t i = 0; i < n; i++)
        if (polygons[i].corners > most) most = polygons[i].corners;
    uint32_t *corner = malloc(most * sizeof *corner), (*cut)[3] = malloc(most * sizeof *cut);
    bool ok = corner && cut;
    for (uint32_t i = 0; ok && i < n; i++) {
        const MeshPolygon *polygon = &polygons[i];
        read_fan(m->triangle, polygon, corner);
        ok = polygon_triangulate((const float (*)[3])m->position, corner, polygon->corners, cut);
        if (!ok) break;
        write_cut(m->triangle, polygon, corner, cut);
        uint32_t (*attribute[2])[3] = { m->triangle_normal, m->triangle_uv };
        for (int k = 0; k < 2; k++)
            if (attribute[k]) {
                read_fan(attribute[k], polygon, corner);
                write_cut(attribute[k], polygon, corner, cut);
            }
    }
    free(corner);
    free(cut);
    return ok;
}

static void swap_last(uint32_t triangle[3]) { mesh_set3(triangle, triangle[0], triangle[2], triangle[1]); }

/* Drops triangles without area, normals that not all three corners have, and turns the triangles that their normals see from behind.
 * False if memory runs out. */
static bool settle_triangles(Mesh *m)
{
    uint32_t kept = 0;
    bool any_normal = false;
    for (uint32_t i = 0; i < m->n_triangles; i++) {
        uint32_t *t = m->triangle[i], *n = m->triangle_normal ? m->triangle_normal[i] : NULL;
        Vec3 a = from_float(m->position[t[0]]), e1 = sub(from_float(m->position[t[1]]), a), e2 = sub(from_float(m->position[t[2]]), a);
        Vec3 ng = cross(e1, e2);
        /* What the rounding of the cross product alone can leave is no area. */
        if (dot(ng, ng) <= 1e-30 * dot(e1, e1) * dot(e2, e2)) continue;
        bool turned = false;
        if (n) {
            Vec3 sum = vec3(0, 0, 0);
            for (int k = 0; k < 3; k++)
                sum = n[k] < m->n_normals ? add(sum, from_float(m->normal[n[k]])) : vec3(NAN, NAN, NAN);
            double side = dot(sum, ng);
            turned = side < 0;
            if (isnan(side)) n[0] = BVH_NONE;
            else any_normal = true;
        }
        uint32_t *uv = m->triangle_uv ? m->triangle_uv[i] : NULL;
        if (turned) {
            swap_last(t);
            swap_last(n);
            if (uv) swap_last(uv);
        }
        if (kept < i) {
            m->triangle_material[kept] = m->triangle_material[i];
            mesh_set3(m->triangle[kept], t[0], t[1], t[2]);
            if (n) mesh_set3(m->triangle_normal[kept], n[0], n[1], n[2]);
            if (uv) mesh_set3(m->triangle_uv[kept], uv[0], uv[1], uv[2]);
        }
        kept++;
    }
    m->n_triangles = kept;
    if (!any_normal) {
        free(m->triangle_normal);
        free(m->normal);
        m->triangle_normal = NULL;
        m->normal = NULL;
        m->n_normals = 0;
        return true;
    }
    return drop_unused(m->normal, sizeof *m->normal, &m->n_normals, m->triangle_normal, kept);
}

const char *mesh_finish(Mesh *m, double (*position)[3], const MeshPolygon *polygon, uint32_t n_polygons)
{
    if (!drop_unused(position, sizeof *position, &m->n_positions, m->triangle, m->n_triangles)) {
        free(position);
        return out_of_memory;
    }
    const char *wrong = scale_positions(m, position);
    if (wrong) {
        free(position);
        return wrong;
    }
    return cut_polygons(m, polygon, n_polygons) && settle_triangles(m) ? NULL : out_of_memory;
}

bool mesh_finish_uvs(Mesh *m)
{
    bool any = false;
    for (uint32_t i = 0; m->triangle_uv && i < m->n_triangles; i++) {
        uint32_t *t = m->triangle_uv[i];
        bool has = m->material[m->triangle_material[i]].map_kd != NULL;
        for (int k = 0; has && k < 3; k++) has = t[k] < m->n_uvs && !isnan(m->uv[t[k]][0]);
        if (has) any = true;
        else t[0] = BVH_NONE;
    }
    if (any) return drop_unused(m->uv, sizeof *m->uv, &m->n_uvs, m->triangle_uv, m->n_triangles);
    free(m->triangle_uv);
    free(m->uv);
    m->triangle_uv = NULL;
    m->uv = NULL;
    m->n_uvs = 0;
    return true;
}

void *mesh_shrunk(void *array, size_t bytes)
{
    void *moved = array && bytes ? realloc(array, bytes) : NULL;
    return moved ? moved : array;
}

void mesh_trim(Mesh *m)
{
    m->position = mesh_shrunk(m->position, m->n_positions * sizeof *m->position);
    m->normal = mesh_shrunk(m->normal, m->n_normals * sizeof *m->normal);
    m->uv = mesh_shrunk(m->uv, m->n_uvs * sizeof *m->uv);
    m->triangle = mesh_shrunk(m->triangle, m->n_triangles * sizeof *m->triangle);
    m->triangle_normal = mesh_shrunk(m->triangle_normal, m->n_triangles * sizeof *m->triangle_normal);
    m->triangle_uv = mesh_shrunk(m->triangle_uv, m->n_triangles * sizeof *m->triangle_uv);
    m->triangle_material = mesh_shrunk(m->triangle_material, m->n_triangles * sizeof *m->triangle_material);
    m->material = mesh_shrunk(m->material, m->n_materials * sizeof *m->material);
}

void mesh_free(Mesh *mesh)
{
    for (uint32_t i = 0; i < mesh->n_materials; i++) free(mesh->material[i].name);
    for (uint32_t i = 0; i < mesh->n_textures; i++) image_free(mesh->texture[i]);
    free(mesh->texture);
    free(mesh->material);
    free(mesh->position);
    free(mesh->normal);
    free(mesh->uv);
    free(mesh->triangle);
    free(mesh->triangle_normal);
    free(mesh->triangle_uv);
    free(mesh->triangle_material);
    *mesh = (Mesh){ 0 };
}
