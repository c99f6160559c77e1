/* The reader of OBJ files: text to Mesh.
 *
 * Source: Wavefront's OBJ as its specification and the common exporters have it. One pass over the text appends what it finds to arrays, faces
 * already as fans of triangles; the rest waits for the end of the file, because faces may come before their vertices and materials after
 * their use: ranges of indices, materials, the scene's unit, better triangles, the sides that vertex normals ask for, and what nothing uses.
 * What makes the mesh wrong is an error with its line; what only spoils an attribute is a warning, and the attribute is dropped.
 * Must not know what an MTL statement means (mtl.c), how numbers are read (text.c) or polygons cut (polygon.c). */
#include "obj.h"
#include "mtl.h"
#include "polygon.h"
#include "text.h"
#include <stdlib.h>
#include <string.h>

typedef struct { uint32_t position, uv, normal; } Corner;          /* BVH_NONE = absent */

typedef struct { uint32_t first, corners; } Polygon;               /* its corners - 2 triangles are a fan, from 'first' on */

/* The largest index that pointed beyond what had been read. */
typedef struct {
    int64_t index;
    unsigned long line;
} Forward;

typedef struct {
    Text text;
    Report *report;
    Notes notes;
    Mesh mesh;                                 /* its arrays grow; position stays empty until the end */
    double (*position)[3];                     /* [mesh.n_positions], user unit */
    Corner *corner;                            /* of the current face */
    Polygon *polygon;                          /* all faces of more than three corners */
    uint32_t n_polygons;
    uint32_t positions_capacity, normals_capacity, uvs_capacity, triangles_capacity, corners_capacity, polygons_capacity, lines_capacity;
    Forward forward_position, forward_uv, forward_normal;
    Names used;                                /* arguments of usemtl */
    unsigned long *used_line;                  /* [used.n] where first named */
    uint32_t material;                         /* number in 'used' of the current material, BVH_NONE = none */
    bool wants_uv;                             /* whether that may have a texture */
    unsigned long recognised;                  /* statements whose keyword is known */
    MtlLibrary library;
} Reader;

static bool error(Reader *r, const char *why)
{
    return report_error(r->report, r->text.path, r->text.line, "%s", why);
}

static bool out_of_memory(Reader *r)
{
    return report_error(r->report, r->text.path, 0, "out of memory, or more than 4294967294 elements of a kind");
}

static void warn(Reader *r, const char *kind) { note(&r->notes, r->text.path, r->text.line, kind); }

/* Says what is wrong with the token at p, where a number should be. */
static bool number_error(Reader *r, char *p)
{
    if (is_stop(*p)) return error(r, "the line ends where a number should be");
    return report_error(r->report, r->text.path, r->text.line, "'%s' %s", quote_token(p).text, number_fault(p));
}

/* Statements. Each gets the line from its first argument on and returns where it stopped reading, to be checked for leftovers by the caller,
 * or NULL after an error. Nothing is stored before the line is known to be right, as a line with leftovers may be read again (text_join). */

/* Numbers separated by blanks; returns how many. *end is where reading stopped. */
static inline int read_numbers(char *p, double *value, int most, char **end)
{
    int n = 0;
    for (; n < most; n++) {
        p = skip_blanks(p);
        if (is_stop(*p)) break;
        char *q = number_scan(p, &value[n]);
        if (!q || !is_token_end(*q)) break;
        p = q;
    }
    *end = p;
    return n;
}

/* v x y z, and then nothing, w, a colour of three or four numbers, or both. */
static char *read_position(Reader *r, char *p)
{
    double v[3], extra[5];
    char *end;
    if (read_numbers(p, v, 3, &end) < 3) return *end == '\\' || number_error(r, end) ? end : NULL;
    if (*end != '\n') {
        end = skip_blanks(end);
        if (!is_stop(*end) && *end != '\\') {
            int n = read_numbers(end, extra, 5, &end);
            end = skip_blanks(end);
            if (*end == '\\') return end;
            if (!is_stop(*end)) warn(r, n < 5 ? "extra values of a vertex that are no numbers" : "more values than a vertex can have");
            else if (n == 1 && extra[0] != 1) warn(r, "the weight w of vertices is ignored");
            else if (n > 1) warn(r, n == 2 ? "extra values of a vertex are ignored" : "vertex colours are ignored");
            end = find_line_end(end);
        }
    }
    Mesh *m = &r->mesh;
    if (m->n_positions == r->positions_capacity && !array_grow(&r->position, m->n_positions, &r->positions_capacity, sizeof *r->position))
        return out_of_memory(r), NULL;
    memcpy(r->position[m->n_positions++], v, sizeof v);
    return end;
}

/* vt u [v [w]]. What cannot be read is kept as NAN: it counts, and faces that use it have no texture coordinates. */
static char *read_uv(Reader *r, char *p)
{
    double v[3] = { 0, 0, 0 };
    char *end;
    int n = read_numbers(p, v, 3, &end);
    end = skip_blanks(end);
    if (*end == '\\') return end;
    if (n == 1) v[1] = 0;
    if (n == 0 || !is_stop(*end) || fabs(v[0]) > (double)FLT_MAX || fabs(v[1]) > (double)FLT_MAX) {
        warn(r, "texture coordinates that cannot be read");
        v[0] = v[1] = NAN;
        end = find_line_end(end);
    }
    Mesh *m = &r->mesh;
    if (m->n_uvs == r->uvs_capacity && !array_grow(&m->uv, m->n_uvs, &r->uvs_capacity, sizeof *m->uv)) return out_of_memory(r), NULL;
    m->uv[m->n_uvs][0] = (float)v[0];
    m->uv[m->n_uvs++][1] = (float)v[1];
    return end;
}

/* vn x y z, brought to length 1. What has no direction is kept as NAN, like a vt. */
static char *read_normal(Reader *r, char *p)
{
    static const double shortest = 1e-6;       /* what six printed decimals cannot give a direction to */
    double v[3] = { 0, 0, 0 };
    char *end;
    int n = read_numbers(p, v, 3, &end);
    end = skip_blanks(end);
    if (*end == '\\') return end;
    double l = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (n < 3 || !is_stop(*end) || !(l >= shortest && l <= DBL_MAX)) {
        warn(r, n < 3 || !is_stop(*end) ? "normals that cannot be read" : "normals without a direction");
        l = NAN;
        end = find_line_end(end);
    }
    Mesh *m = &r->mesh;
    if (m->n_normals == r->normals_capacity && !array_grow(&m->normal, m->n_normals, &r->normals_capacity, sizeof *m->normal))
        return out_of_memory(r), NULL;
    float *normal = m->normal[m->n_normals++];
    for (int i = 0; i < 3; i++) normal[i] = (float)(v[i] * (1 / l));
    return end;
}

/* An index as written, from 1 or, negative, from the end of the 'count' elements so far. Returns where it ends, NULL if there is no integer
 * at p. *out is BVH_NONE if it cannot be in range; one that points beyond 'count' is kept and judged at the end of the file. */
static char *read_any_index(Reader *r, char *p, uint32_t count, Forward *forward, uint32_t *out)
{
    int64_t index;
    char *end = integer_scan(p, &index);
    *out = BVH_NONE;
    if (!end) return NULL;
    if (index < 0) index += (int64_t)count + 1;
    if (index <= 0 || index > UINT32_MAX - 1) return end;
    if (index > count && index > forward->index) *forward = (Forward){ index, r->text.line };
    *out = (uint32_t)(index - 1);
    return end;
}

/* The same, quick for what most files have. */
static inline char *read_index(Reader *r, char *p, uint32_t count, Forward *forward, uint32_t *out)
{
    uint64_t index;
    unsigned n = scan_digits(p, &index);
    if (n == 8 || index - 1 >= count) return read_any_index(r, p, count, forward, out);
    *out = (uint32_t)(index - 1);
    return p + n;
}

/* The index after a slash, if there is one. */
static inline char *read_attribute(Reader *r, char *p, uint32_t count, Forward *forward, uint32_t *attribute)
{
    if (*p == '/' || is_token_end(*p)) return p;
    p = read_index(r, p, count, forward, attribute);
    if (*attribute == BVH_NONE && p) warn(r, "indices of normals or texture coordinates out of range");
    return p;
}

static bool index_error(Reader *r, char *p)
{
    return report_error(r->report, r->text.path, r->text.line, "'%s' is not a corner of a face: V, V/VT, V//VN or V/VT/VN", quote_token(p).text);
}

static char *read_corners(Reader *r, char *p, uint32_t *n)
{
    const Mesh *m = &r->mesh;
    for (*n = 0;; ++*n) {
        p = skip_blanks(p);
        if (is_stop(*p) || *p == '\\') return p;
        if (*n == r->corners_capacity && !array_grow(&r->corner, *n, &r->corners_capacity, sizeof *r->corner)) return out_of_memory(r), NULL;
        Corner c = { BVH_NONE, BVH_NONE, BVH_NONE };
        char *q = read_index(r, p, m->n_positions, &r->forward_position, &c.position);
        if (!q) return index_error(r, p), NULL;
        if (c.position == BVH_NONE)
            return report_error(r->report, r->text.path, r->text.line, "vertex index %s is out of range: %u vertices so far",
                                quote_token(p).text, (unsigned)m->n_positions), NULL;
        if (*q == '/') q = read_attribute(r, q + 1, m->n_uvs, &r->forward_uv, &c.uv);
        if (q && *q == '/') q = read_attribute(r, q + 1, m->n_normals, &r->forward_normal, &c.normal);
        if (!q || !is_token_end(*q)) return index_error(r, p), NULL;
        r->corner[*n] = c;
        p = q;
    }
}

/* Adds room for one triangle; the arrays of attributes exist only from the first face that has them. */
static bool grow_triangles(Reader *r)
{
    Mesh *m = &r->mesh;
    uint32_t n = m->n_triangles, capacity = r->triangles_capacity, c = capacity;
    if (!array_grow(&m->triangle, n, &c, sizeof *m->triangle)) return out_of_memory(r);
    if (m->triangle_normal && !array_grow(&m->triangle_normal, n, (c = capacity, &c), sizeof *m->triangle_normal)) return out_of_memory(r);
    if (m->triangle_uv && !array_grow(&m->triangle_uv, n, (c = capacity, &c), sizeof *m->triangle_uv)) return out_of_memory(r);
    if (!array_grow(&m->triangle_material, n, (c = capacity, &c), sizeof *m->triangle_material)) return out_of_memory(r);
    r->triangles_capacity = c;
    return true;
}

/* An array of attributes in which the triangles so far have none. */
static bool begin_attribute(Reader *r, uint32_t (**attribute)[3])
{
    *attribute = malloc(r->triangles_capacity * sizeof **attribute);
    if (!*attribute) return out_of_memory(r);
    for (uint32_t i = 0; i < r->mesh.n_triangles; i++) (*attribute)[i][0] = BVH_NONE;
    return true;
}

static inline void set3(uint32_t target[3], uint32_t a, uint32_t b, uint32_t c)
{
    target[0] = a;
    target[1] = b;
    target[2] = c;
}

static bool add_face(Reader *r, uint32_t n)
{
    Mesh *m = &r->mesh;
    if (n < 3) {
        warn(r, "faces with fewer than three corners are dropped");
        return true;
    }
    if (n > 3) {
        if (!array_grow(&r->polygon, r->n_polygons, &r->polygons_capacity, sizeof *r->polygon)) return out_of_memory(r);
        r->polygon[r->n_polygons++] = (Polygon){ m->n_triangles, n };
    }
    const Corner *a = r->corner;
    for (uint32_t i = 1; i + 1 < n; i++) {
        const Corner *b = &a[i], *c = &a[i + 1];
        if (m->n_triangles == r->triangles_capacity && !grow_triangles(r)) return false;
        uint32_t k = m->n_triangles;
        if (!m->triangle_uv && r->wants_uv && (a->uv & b->uv & c->uv) != BVH_NONE && !begin_attribute(r, &m->triangle_uv)) return false;
        if (!m->triangle_normal && (a->normal & b->normal & c->normal) != BVH_NONE && !begin_attribute(r, &m->triangle_normal)) return false;
        set3(m->triangle[k], a->position, b->position, c->position);
        if (m->triangle_uv) set3(m->triangle_uv[k], a->uv, b->uv, c->uv);
        if (m->triangle_normal) set3(m->triangle_normal[k], a->normal, b->normal, c->normal);
        m->triangle_material[k] = r->material;
        m->n_triangles++;
    }
    return true;
}

/* The rest of the line as a name, blanks inside and # included; its length. */
static size_t name_length(char *p)
{
    char *end = find_line_end(p);
    while (end > p && is_blank(end[-1])) end--;
    return (size_t)(end - p);
}

/* The number in the library of the name that usemtl has used, as it stands or without ' # comment'; BVH_NONE if there is none. */
static uint32_t find_material(const Reader *r, const char *name)
{
    size_t n = strlen(name);
    uint32_t number = names_find(&r->library.names, name, n);
    for (const char *mark = strchr(name, '#'); number == BVH_NONE && mark; mark = strchr(mark + 1, '#')) {
        size_t k = (size_t)(mark - name);
        if (k == 0 || !is_blank(name[k - 1])) continue;
        while (k > 0 && is_blank(name[k - 1])) k--;
        number = names_find(&r->library.names, name, k);
    }
    return number;
}

static bool use_material(Reader *r, char *p)
{
    size_t n = name_length(p);
    uint32_t before = r->used.n, number;
    r->material = BVH_NONE;
    r->wants_uv = false;
    if (n == 0) {
        warn(r, "usemtl without a name");
        return true;
    }
    if (!array_grow(&r->used_line, before, &r->lines_capacity, sizeof *r->used_line)) return out_of_memory(r);
    r->material = names_add(&r->used, p, n);
    if (r->material == BVH_NONE) return out_of_memory(r);
    if (r->material == before) r->used_line[before] = r->text.line;
    number = find_material(r, r->used.name[r->material]);
    r->wants_uv = number == BVH_NONE || r->library.entry[number].map_found;     /* unknown: a later library may have it */
    return true;
}

static bool read_library(Reader *r, const char *name, size_t n, bool *found)
{
    char *path = text_find_file(r->text.path, name, n);
    *found = path != NULL;
    bool ok = !path || mtl_read(&r->library, path, &r->notes);
    free(path);
    return ok || out_of_memory(r);
}

/* The argument of mtllib is the name of one file or, if there is none such, of several. */
static bool read_libraries(Reader *r, char *p)
{
    size_t n = name_length(p);
    bool found = false;
    if (n == 0) warn(r, "mtllib without a file");
    else if (!read_library(r, p, n, &found)) return false;
    for (char *name = skip_blanks(p); !found && !is_stop(*name);) {
        bool this_one;
        char *end = name;
        while (!is_blank(*end) && !is_line_end(*end)) end++;
        if (!read_library(r, name, (size_t)(end - name), &this_one)) return false;
        if (!this_one) note_name(&r->notes, r->text.path, r->text.line, "material library not found:", name, (size_t)(end - name));
        name = skip_blanks(end);
    }
    return true;
}

static char *read_smoothing(Reader *r, char *p)
{
    double group;
    char *end = skip_token(p);
    size_t n = (size_t)(end - p);
    bool word = (n == 2 && memcmp(p, "on", 2) == 0) || (n == 3 && memcmp(p, "off", 3) == 0);
    if (n > 0 && !word && number_scan(p, &group) != end) warn(r, "smoothing group that is no number");
    return find_line_end(p);
}

/* All but the commonest statements. The line is whole: text_join has seen to that. */
static char *read_other(Reader *r, char *p)
{
    enum { FACE, POSITION, UV, NORMAL, USEMTL, MTLLIB, SMOOTHING, NOTHING, UNSUPPORTED, CURVE, LINE };
    static const struct { const char *word; int meaning; } keywords[] = {
        { "f", FACE }, { "fo", FACE }, { "v", POSITION }, { "vt", UV }, { "vn", NORMAL }, { "usemtl", USEMTL }, { "mtllib", MTLLIB },
        { "s", SMOOTHING }, { "g", NOTHING }, { "o", NOTHING }, { "p", NOTHING }, { "vp", NOTHING }, { "vw", NOTHING }, { "mg", NOTHING },
        { "bevel", NOTHING }, { "c_interp", NOTHING }, { "d_interp", NOTHING }, { "lod", NOTHING }, { "ctech", NOTHING }, { "stech", NOTHING },
        { "maplib", UNSUPPORTED }, { "usemap", UNSUPPORTED }, { "shadow_obj", UNSUPPORTED }, { "trace_obj", UNSUPPORTED },
        { "call", UNSUPPORTED }, { "csh", UNSUPPORTED }, { "l", LINE },
        { "cstype", CURVE }, { "deg", CURVE }, { "bmat", CURVE }, { "step", CURVE }, { "curv", CURVE }, { "curv2", CURVE }, { "surf", CURVE },
        { "parm", CURVE }, { "trim", CURVE }, { "hole", CURVE }, { "scrv", CURVE }, { "sp", CURVE }, { "end", CURVE }, { "con", CURVE },
        { "bsp", CURVE }, { "bzp", CURVE }, { "cdc", CURVE }, { "cdp", CURVE }, { "res", CURVE }
    };
    char *word = p;
    size_t n = (size_t)(skip_token(p) - p), i = 0;
    if (memchr(p, 0, (size_t)(find_line_end(p) - p))) return error(r, "binary data, not an OBJ file"), NULL;
    while (i < sizeof keywords / sizeof keywords[0] && !(strlen(keywords[i].word) == n && memcmp(keywords[i].word, p, n) == 0)) i++;
    if (i == sizeof keywords / sizeof keywords[0]) {
        note_name(&r->notes, r->text.path, r->text.line, "unknown keyword", word, n);
        return find_line_end(p);
    }
    r->recognised++;
    p = skip_blanks(p + n);
    switch (keywords[i].meaning) {
    case POSITION: return read_position(r, p);
    case UV: return read_uv(r, p);
    case NORMAL: return read_normal(r, p);
    case USEMTL: return use_material(r, p) ? find_line_end(p) : NULL;
    case MTLLIB: return read_libraries(r, p) ? find_line_end(p) : NULL;
    case SMOOTHING: return read_smoothing(r, p);
    case CURVE: warn(r, "curves and surfaces are not supported"); break;
    case LINE: warn(r, "lines are not rendered"); break;
    case UNSUPPORTED: note_name(&r->notes, r->text.path, r->text.line, "not supported and ignored:", word, n); break;
    default: break;
    }
    if (keywords[i].meaning != FACE) return find_line_end(p);
    uint32_t corners;
    p = read_corners(r, p, &corners);
    return p && (*p == '\\' || add_face(r, corners)) ? p : NULL;
}

static bool read_lines(Reader *r)
{
    Text *t = &r->text;
    for (char *p = t->p; p < t->end;) {
        p = skip_blanks(p);
        char *start = p, *next;
        for (bool joined = false;; joined = true) {
            uint32_t corners = 0;
            if (is_stop(*start)) p = start;
            else if (start[0] == 'v' && is_blank(start[1])) p = read_position(r, start + 2);
            else if (start[0] == 'v' && start[1] == 'n' && is_blank(start[2])) p = read_normal(r, start + 3);
            else if (start[0] == 'v' && start[1] == 't' && is_blank(start[2])) p = read_uv(r, start + 3);
            else if (start[0] == 'f' && is_blank(start[1])) {
                p = read_corners(r, start + 2, &corners);
                if (p && *p != '\\' && !add_face(r, corners)) return false;
            } else if (!joined && text_join(t, start)) {
                start = skip_blanks(start);
                continue;
            } else p = read_other(r, start);
            if (!p) return false;
            next = text_finish_line(t, p);
            if (next) break;
            if (joined || !text_join(t, start)) return error(r, "a backslash inside a line");
        }
        p = next;
    }
    return true;
}

/* The end of the file. */

static bool is_none(const uint32_t triangle[3]) { return triangle[0] == BVH_NONE; }

/* Drops the items that no triangle uses, and renumbers. */
static bool drop_unused(Reader *r, void *item, size_t size, uint32_t *n, uint32_t (*triangle)[3])
{
    uint32_t kept = 0, n_triangles = r->mesh.n_triangles;
    unsigned char *used = calloc((size_t)*n + 1, 1);
    if (!used) return out_of_memory(r);
    for (uint32_t i = 0; i < n_triangles; i++)
        if (!is_none(triangle[i])) used[triangle[i][0]] = used[triangle[i][1]] = used[triangle[i][2]] = 1;
    for (uint32_t i = 0; i < *n; i++) kept += used[i];
    uint32_t *number = NULL;
    if (kept < *n) {
        number = malloc(*n * sizeof *number);
        if (!number) return free(used), out_of_memory(r);
        kept = 0;
        for (uint32_t i = 0; i < *n; i++) {
            if (!used[i]) continue;
            memmove((char *)item + kept * size, (char *)item + i * size, size);
            number[i] = kept++;
        }
        for (uint32_t i = 0; i < n_triangles; i++)
            if (!is_none(triangle[i])) set3(triangle[i], number[triangle[i][0]], number[triangle[i][1]], number[triangle[i][2]]);
        *n = kept;
    }
    free(number);
    free(used);
    return true;
}

/* Finds centre and unit (scene.h) and turns the positions into floats, in their place. */
static bool scale_positions(Reader *r)
{
    Mesh *m = &r->mesh;
    double low[3], high[3], centre[3], half = 0;
    memcpy(low, r->position[0], sizeof low);
    memcpy(high, low, sizeof high);
    for (uint32_t i = 1; i < m->n_positions; i++)
        for (int k = 0; k < 3; k++) {
            double x = r->position[i][k];
            low[k] = x < low[k] ? x : low[k];
            high[k] = x > high[k] ? x : high[k];
        }
    for (int k = 0; k < 3; k++) {
        centre[k] = low[k] / 2 + high[k] / 2;
        half = fmax(half, fmax(high[k] - centre[k], centre[k] - low[k]));      /* of the rounded centre: no position gets beyond 1 */
    }
    int exponent = 0;
    if (half > 0 && frexp(half, &exponent) == 0.5) exponent--;
    if (exponent < -1000 || exponent > 1000) return report_error(r->report, r->text.path, 0, "the scene is too %s", half < 1 ? "small" : "large");
    m->centre = vec3(centre[0], centre[1], centre[2]);
    m->unit = ldexp(1, exponent);
    double per_unit = ldexp(1, -exponent);
    char *bytes = (char *)r->position;
    for (uint32_t i = 0; i < m->n_positions; i++) {
        double x[3];
        float f[3];
        memcpy(x, bytes + i * sizeof x, sizeof x);
        for (int k = 0; k < 3; k++) f[k] = (float)((x[k] - centre[k]) * per_unit);
        memcpy(bytes + i * sizeof f, f, sizeof f);
    }
    m->position = (float (*)[3])(void *)bytes;
    r->position = NULL;
    return true;
}

static void read_fan(uint32_t (*triangle)[3], const Polygon *polygon, uint32_t *corner)
{
    corner[0] = triangle[polygon->first][0];
    corner[1] = triangle[polygon->first][1];
    for (uint32_t i = 2; i < polygon->corners; i++) corner[i] = triangle[polygon->first + i - 2][2];
}

static void write_cut(uint32_t (*triangle)[3], const Polygon *polygon, const uint32_t *corner, uint32_t (*cut)[3])
{
    for (uint32_t i = 0; i + 2 < polygon->corners; i++)
        set3(triangle[polygon->first + i], corner[cut[i][0]], corner[cut[i][1]], corner[cut[i][2]]);
}

/* Better triangles than fans for the polygons. */
static bool cut_polygons(Reader *r)
{
    Mesh *m = &r->mesh;
    uint32_t *corner = malloc(r->corners_capacity * sizeof *corner), (*cut)[3] = malloc(r->corners_capacity * sizeof *cut);
    bool ok = corner && cut;
    for (uint32_t i = 0; ok && i < r->n_polygons; i++) {
        const Polygon *polygon = &r->polygon[i];
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
    return ok || out_of_memory(r);
}

static void swap_last(uint32_t triangle[3]) { set3(triangle, triangle[0], triangle[2], triangle[1]); }

/* Drops triangles without area, normals that not all three corners have, and turns the triangles that their normals see from behind. */
static bool settle_triangles(Reader *r)
{
    Mesh *m = &r->mesh;
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
        m->triangle_material[kept] = m->triangle_material[i];
        set3(m->triangle[kept], t[0], t[1], t[2]);
        if (turned) swap_last(m->triangle[kept]);
        if (n) {
            set3(m->triangle_normal[kept], n[0], n[1], n[2]);
            if (turned) swap_last(m->triangle_normal[kept]);
        }
        if (m->triangle_uv) {
            const uint32_t *uv = m->triangle_uv[i];
            set3(m->triangle_uv[kept], uv[0], uv[1], uv[2]);
            if (turned) swap_last(m->triangle_uv[kept]);
        }
        kept++;
    }
    if (kept < m->n_triangles) report_warning(r->report, r->text.path, 0, "%u triangles without area are dropped", (unsigned)(m->n_triangles - kept));
    m->n_triangles = kept;
    if (!any_normal) {
        free(m->triangle_normal);
        free(m->normal);
        m->triangle_normal = NULL;
        m->normal = NULL;
        m->n_normals = 0;
        return true;
    }
    return drop_unused(r, m->normal, sizeof *m->normal, &m->n_normals, m->triangle_normal);
}

/* Makes the materials that the triangles use, in the order of their first use, and numbers the triangles with them. */
static bool bind_materials(Reader *r)
{
    Mesh *m = &r->mesh;
    size_t n_used = r->used.n, n_known = r->library.names.n;
    uint32_t *of_used = malloc((n_used + 1) * sizeof *of_used), *of_known = malloc((n_known + 1) * sizeof *of_known), capacity = 0;
    bool ok = of_used && of_known;                     /* the last of each stands for the default */
    for (size_t i = 0; ok && i <= n_used; i++) of_used[i] = BVH_NONE;
    for (size_t i = 0; ok && i <= n_known; i++) of_known[i] = BVH_NONE;
    for (uint32_t i = 0; ok && i < m->n_triangles; i++) {
        uint32_t used = m->triangle_material[i], *made = &of_used[used == BVH_NONE ? n_used : used];
        if (*made == BVH_NONE) {
            const char *name = used == BVH_NONE ? NULL : r->used.name[used];
            uint32_t number = name ? find_material(r, name) : BVH_NONE, *known = &of_known[number == BVH_NONE ? n_known : number];
            if (name && number == BVH_NONE)
                note_name(&r->notes, r->text.path, r->used_line[used], "unknown material, 0.5 grey is used:", name, strlen(name));
            if (*known == BVH_NONE) {
                ok = array_grow(&m->material, m->n_materials, &capacity, sizeof *m->material);
                Material *material = ok ? &m->material[m->n_materials] : NULL;
                ok = ok && (number == BVH_NONE ? mtl_default(material) : mtl_material(&r->library, number, material, &r->notes, r->report));
                if (!ok) break;
                *known = m->n_materials++;
            }
            *made = *known;
        }
        m->triangle_material[i] = *made;
    }
    free(of_used);
    free(of_known);
    ok = ok && mtl_textures(&r->library, &m->texture, &m->n_textures);
    return ok || out_of_memory(r);
}

/* Keeps texture coordinates only where there is a texture and all three corners have them. */
static bool settle_uvs(Reader *r)
{
    Mesh *m = &r->mesh;
    bool any = false;
    for (uint32_t i = 0; m->triangle_uv && i < m->n_triangles; i++) {
        uint32_t *t = m->triangle_uv[i];
        bool has = m->material[m->triangle_material[i]].map_kd != NULL;
        for (int k = 0; has && k < 3; k++) has = t[k] < m->n_uvs && !isnan(m->uv[t[k]][0]);
        if (has) any = true;
        else t[0] = BVH_NONE;
    }
    if (any) return drop_unused(r, m->uv, sizeof *m->uv, &m->n_uvs, m->triangle_uv);
    free(m->triangle_uv);
    free(m->uv);
    m->triangle_uv = NULL;
    m->uv = NULL;
    m->n_uvs = 0;
    return true;
}

/* Gives back what the growth of an array has reserved; keeps the array if that fails. */
static void *trim(void *array, size_t bytes)
{
    void *moved = array && bytes ? realloc(array, bytes) : NULL;
    return moved ? moved : array;
}

static void trim_mesh(Mesh *m)
{
    m->position = trim(m->position, m->n_positions * sizeof *m->position);
    m->normal = trim(m->normal, m->n_normals * sizeof *m->normal);
    m->uv = trim(m->uv, m->n_uvs * sizeof *m->uv);
    m->triangle = trim(m->triangle, m->n_triangles * sizeof *m->triangle);
    m->triangle_normal = trim(m->triangle_normal, m->n_triangles * sizeof *m->triangle_normal);
    m->triangle_uv = trim(m->triangle_uv, m->n_triangles * sizeof *m->triangle_uv);
    m->triangle_material = trim(m->triangle_material, m->n_triangles * sizeof *m->triangle_material);
    m->material = trim(m->material, m->n_materials * sizeof *m->material);
}

static void warn_forward(Reader *r, const Forward *forward, uint32_t n, const char *kind)
{
    if (forward->index > n) note(&r->notes, r->text.path, forward->line, kind);
}

static bool finish(Reader *r)
{
    Mesh *m = &r->mesh;
    const char *path = r->text.path;
    if (r->forward_position.index > m->n_positions)
        return report_error(r->report, path, r->forward_position.line, "vertex index %lld is out of range: the file has %u vertices",
                            (long long)r->forward_position.index, (unsigned)m->n_positions);
    bool foreign = r->recognised == 0 && m->n_positions == 0 && r->notes.n > 0;
    if (m->n_triangles == 0) return report_error(r->report, path, 0, foreign ? "not an OBJ file" : "no geometry: the file has no face");
    warn_forward(r, &r->forward_normal, m->n_normals, "indices of normals or texture coordinates out of range");
    warn_forward(r, &r->forward_uv, m->n_uvs, "indices of normals or texture coordinates out of range");
    if (!drop_unused(r, r->position, sizeof *r->position, &m->n_positions, m->triangle) || !scale_positions(r) || !cut_polygons(r)) return false;
    if (!settle_triangles(r)) return false;
    if (m->n_triangles == 0) return report_error(r->report, path, 0, "no geometry: no face has an area");
    if (!bind_materials(r) || !settle_uvs(r)) return false;
    trim_mesh(m);
    return true;
}

bool obj_read(Mesh *mesh, const char *path, Report *report)
{
    Reader *r = calloc(1, sizeof *r);
    int error_number;
    *mesh = (Mesh){ 0 };
    if (!r) return report_error(report, path, 0, "out of memory");
    r->report = report;
    r->material = BVH_NONE;
    bool opened = text_open(&r->text, path, &error_number), ok = opened;
    while (ok && text_more(&r->text)) ok = read_lines(r);
    if (r->text.error) ok = report_error(report, path, 0, "%s", r->text.error);
    ok = ok && finish(r);
    notes_print(&r->notes, report);
    if (opened) text_close(&r->text);
    if (ok) *mesh = r->mesh;
    else mesh_free(&r->mesh);
    free(r->position);
    free(r->corner);
    free(r->polygon);
    free(r->used_line);
    names_free(&r->used);
    mtl_free(&r->library);
    free(r);
    return ok;
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
