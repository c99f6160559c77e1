/* The reader of OBJ files: text to Mesh.
 *
 * Source: Wavefront's OBJ as its specification and the common exporters have it. One pass over the text appends what it finds to arrays, faces
 * already as fans of triangles; the rest waits for the end of the file, because faces may come before their vertices and materials after
 * their use: ranges of indices and materials here, all that needs positions in mesh.c.
 * What makes the mesh wrong is an error with its line; what only spoils an attribute is a warning, and the attribute is dropped.
 * Must not know what an MTL statement means (mtl.c) or how numbers are read (text.c). */
#include "obj.h"
#include "cache.h"
#include "mesh.h"
#include "mtl.h"
#include "text.h"
#include <stdlib.h>
#include <string.h>

typedef struct { uint32_t position, uv, normal; } Corner;          /* BVH_NONE = absent */

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
    MeshPolygon *polygon;                      /* all faces of more than three corners */
    uint32_t n_polygons;
    uint32_t positions_capacity, normals_capacity, uvs_capacity, triangles_capacity, corners_capacity, polygons_capacity, lines_capacity;
    bool frugal;                               /* room is made for what is there alone */
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

/* Elements of a kind that the rest of the file may have. */
static uint64_t likely(const Reader *r)
{
    enum { LINE = 16 };                        /* bytes: most are longer in files large enough to matter */
    return r->frugal ? 0 : (r->text.left + (uint64_t)(r->text.end - r->text.p)) / LINE;
}

/* Where address space is short: gives back the room that waits for the rest of the file. False if that has been done before. */
static bool give_back(Reader *r)
{
    if (r->frugal) return false;
    r->frugal = true;
    r->position = mesh_shrunk(r->position, r->mesh.n_positions * sizeof *r->position);
    mesh_trim(&r->mesh);
    r->positions_capacity = r->mesh.n_positions;
    r->normals_capacity = r->mesh.n_normals;
    r->uvs_capacity = r->mesh.n_uvs;
    r->triangles_capacity = r->mesh.n_triangles;
    return true;
}

static bool make_room(Reader *r, void *array, uint32_t n, uint32_t *capacity, size_t item_size)
{
    return array_grow(array, n, capacity, item_size, likely(r)) || (give_back(r) && array_grow(array, n, capacity, item_size, 0)) || out_of_memory(r);
}

/* Statements. Each gets the line from its first argument on and returns where it stopped reading, to be checked for leftovers by the caller,
 * or NULL after an error. Nothing is stored before the line is known to be right, as a line with leftovers may be read again (text_join). */

/* Numbers separated by blanks; returns how many. *end is where reading stopped. */
static int read_any_numbers(char *p, double *value, int most, char **end)
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

/* The same, quick for what most files have. */
static inline int read_numbers(char *p, double *value, int most, char **end)
{
    p = skip_blanks(p);
    *end = numbers_scan(p, most, value);
    return *end ? most : read_any_numbers(p, value, most, end);
}

/* v x y z, and then nothing, w, a colour of three or four numbers, or both. */
static char *read_position(Reader *r, char *p)
{
    double v[3], extra[5];
    char *end;
    if (read_numbers(p, v, 3, &end) < 3) return *end == '\\' || number_error(r, end) ? end : NULL;
    if (*end != '\n') {
        int n = read_any_numbers(end, extra, 5, &end);
        end = skip_blanks(end);
        if (*end == '\\') return end;
        if (n > 0 || !is_stop(*end)) {
            if (!is_stop(*end)) warn(r, n < 5 ? "extra values of a vertex that are no numbers" : "more values than a vertex can have");
            else if (n == 1 && extra[0] != 1) warn(r, "the weight w of vertices is ignored");
            else if (n > 1) warn(r, n == 2 ? "extra values of a vertex are ignored" : "vertex colours are ignored");
            end = find_line_end(end);
        }
    }
    Mesh *m = &r->mesh;
    if (m->n_positions == r->positions_capacity && !make_room(r, &r->position, m->n_positions, &r->positions_capacity, sizeof *r->position)) return NULL;
    memcpy(r->position[m->n_positions++], v, sizeof v);
    return end;
}

/* vt u [v [w]]. What cannot be read is kept as NAN: it counts, and faces that use it have no texture coordinates. */
static char *read_uv(Reader *r, char *p)
{
    double v[3] = { 0, 0, 0 };
    char *end;
    int n = read_numbers(p, v, 2, &end);
    if (n == 2 && *end != '\n') read_any_numbers(end, v + 2, 1, &end);
    end = skip_blanks(end);
    if (*end == '\\') return end;
    if (n == 1) v[1] = 0;
    if (n == 0 || !is_stop(*end) || fabs(v[0]) > (double)FLT_MAX || fabs(v[1]) > (double)FLT_MAX) {
        warn(r, "texture coordinates that cannot be read");
        v[0] = v[1] = NAN;
        end = find_line_end(end);
    }
    Mesh *m = &r->mesh;
    if (m->n_uvs == r->uvs_capacity && !make_room(r, &m->uv, m->n_uvs, &r->uvs_capacity, sizeof *m->uv)) return NULL;
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
    if (m->n_normals == r->normals_capacity && !make_room(r, &m->normal, m->n_normals, &r->normals_capacity, sizeof *m->normal)) return NULL;
    float *normal = m->normal[m->n_normals++];
    for (int i = 0; i < 3; i++) normal[i] = (float)(v[i] * (1 / l));
    return end;
}

/* An index as written, from 1 or, negative, from the end of the 'count' elements so far. Returns where it ends, NULL if there is no integer
 * at p. *out is BVH_NONE if it cannot be in range; one that points beyond 'count' is kept and judged at the end of the file.
 * The index of an attribute may be absent, and if it is out of range that is only worth a warning. */
static char *read_any_index(Reader *r, char *p, uint32_t count, bool attribute, Forward *forward, uint32_t *out)
{
    int64_t index;
    *out = BVH_NONE;
    if (attribute && (*p == '/' || is_token_end(*p))) return p;
    char *end = integer_scan(p, &index);
    if (!end) return NULL;
    if (index < 0) index += (int64_t)count + 1;
    if (index > 0 && index <= UINT32_MAX - 1) {
        *out = (uint32_t)(index - 1);
        if (index > count && index > forward->index) *forward = (Forward){ index, r->text.line };
    } else if (attribute) warn(r, "indices of normals or texture coordinates out of range");
    return end;
}

/* The same, quick for what most files have. */
static inline char *read_index(Reader *r, char *p, uint32_t count, bool attribute, Forward *forward, uint32_t *out)
{
    uint64_t index;
    unsigned n = scan_digits(p, &index);
    if (n == 8 || index - 1 >= count) return read_any_index(r, p, count, attribute, forward, out);
    *out = (uint32_t)(index - 1);
    return p + n;
}

static bool index_error(Reader *r, char *p)
{
    return report_error(r->report, r->text.path, r->text.line, "'%s' is not a corner of a face: V, V/VT, V//VN or V/VT/VN", quote_token(p).text);
}

static char *read_corner(Reader *r, char *p, Corner *c)
{
    const Mesh *m = &r->mesh;
    char *q = read_index(r, p, m->n_positions, false, &r->forward_position, &c->position);
    if (!q) return index_error(r, p), NULL;
    if (c->position == BVH_NONE)
        return report_error(r->report, r->text.path, r->text.line, "vertex index %s is out of range: %u vertices so far",
                            quote_token(p).text, (unsigned)m->n_positions), NULL;
    c->uv = c->normal = BVH_NONE;
    if (*q == '/') q = read_index(r, q + 1, m->n_uvs, true, &r->forward_uv, &c->uv);
    if (q && *q == '/') q = read_index(r, q + 1, m->n_normals, true, &r->forward_normal, &c->normal);
    if (!q || !is_token_end(*q)) return index_error(r, p), NULL;
    return q;
}

/* The same, quick for what most files have; NULL, without an error, if it is not that. */
static inline char *read_common_corner(const uint32_t count[3], char *p, Corner *c)
{
    uint32_t index[3];
    char *end = indices_scan(p, index);
    if (!end || index[0] > count[0] || index[1] > count[1] || index[2] > count[2]) return NULL;
    *c = (Corner){ index[0] - 1, index[1] - 1, index[2] - 1 };     /* absent: BVH_NONE */
    return end;
}

static char *read_corners(Reader *r, char *p, uint32_t *n)
{
    const uint32_t count[3] = { r->mesh.n_positions, r->mesh.n_uvs, r->mesh.n_normals };
    for (uint32_t k = 0;; k++) {
        Corner *corner = r->corner;
        for (uint32_t room = r->corners_capacity; k < room;) {
            char *q = read_common_corner(count, p, &corner[k]);
            if (!q) break;
            k++;
            p = q;
            if (*p != ' ') break;
            p++;
        }
        p = skip_blanks(p);
        *n = k;
        if (is_stop(*p) || *p == '\\') return p;
        if (k == r->corners_capacity && !array_grow(&r->corner, k, &r->corners_capacity, sizeof *r->corner, 0)) return out_of_memory(r), NULL;
        p = read_corner(r, p, &r->corner[k]);
        if (!p) return NULL;
    }
}

/* Adds room for one triangle; the arrays of attributes exist only from the first face that has them. */
static bool grow_triangles(Reader *r)
{
    Mesh *m = &r->mesh;
    const struct { void *array; size_t item_size; } grown[] = {
        { &m->triangle, sizeof *m->triangle }, { &m->triangle_material, sizeof *m->triangle_material },
        { m->triangle_normal ? &m->triangle_normal : NULL, sizeof *m->triangle_normal }, { m->triangle_uv ? &m->triangle_uv : NULL, sizeof *m->triangle_uv } };
    do {
        uint32_t least = UINT32_MAX;
        bool ok = true;
        for (size_t i = 0; ok && i < sizeof grown / sizeof *grown; i++) {
            uint32_t capacity = r->triangles_capacity;
            if (!grown[i].array) continue;
            ok = array_grow(grown[i].array, m->n_triangles, &capacity, grown[i].item_size, likely(r));
            least = capacity < least ? capacity : least;
        }
        if (ok) return r->triangles_capacity = least, true;
    } while (give_back(r));
    return out_of_memory(r);
}

/* An array of attributes in which the triangles so far have none. */
static bool begin_attribute(Reader *r, uint32_t (**attribute)[3])
{
    do *attribute = large_alloc((r->triangles_capacity + (size_t)1) * sizeof **attribute);
    while (!*attribute && give_back(r));
    if (!*attribute) return out_of_memory(r);
    for (uint32_t i = 0; i < r->mesh.n_triangles; i++) mesh_set3((*attribute)[i], BVH_NONE, BVH_NONE, BVH_NONE);
    return true;
}

static bool add_face(Reader *r, uint32_t n)
{
    Mesh *m = &r->mesh;
    if (n < 3) {
        warn(r, "faces with fewer than three corners are dropped");
        return true;
    }
    if (n > 3) {
        if (r->n_polygons == r->polygons_capacity && !make_room(r, &r->polygon, r->n_polygons, &r->polygons_capacity, sizeof *r->polygon)) return false;
        r->polygon[r->n_polygons++] = (MeshPolygon){ m->n_triangles, n };
    }
    const Corner *a = r->corner;
    for (uint32_t i = 1; i + 1 < n; i++) {
        const Corner *b = &a[i], *c = &a[i + 1];
        uint32_t k = m->n_triangles;
        if (!m->triangle_uv && r->wants_uv && (a->uv & b->uv & c->uv) != BVH_NONE && !begin_attribute(r, &m->triangle_uv)) return false;
        if (!m->triangle_normal && (a->normal & b->normal & c->normal) != BVH_NONE && !begin_attribute(r, &m->triangle_normal)) return false;
        if (k == r->triangles_capacity && !grow_triangles(r)) return false;
        mesh_set3(m->triangle[k], a->position, b->position, c->position);
        if (m->triangle_uv) mesh_set3(m->triangle_uv[k], a->uv, b->uv, c->uv);
        if (m->triangle_normal) mesh_set3(m->triangle_normal[k], a->normal, b->normal, c->normal);
        m->triangle_material[k] = r->material;
        m->n_triangles++;
    }
    return true;
}

/* The number in the library of the name that usemtl has used, as it stands or without ' # comment'; BVH_NONE if there is none. */
static uint32_t find_material(const Reader *r, const char *name)
{
    size_t n = strlen(name), k = before_comment(name, n);
    uint32_t number = names_find(&r->library.names, name, n);
    return number == BVH_NONE && k < n ? names_find(&r->library.names, name, k) : number;
}

static bool use_material(Reader *r, char *p)
{
    size_t n = rest_of_line(p);
    uint32_t before = r->used.n, number;
    r->material = BVH_NONE;
    r->wants_uv = false;
    if (n == 0) {
        warn(r, "usemtl without a name");
        return true;
    }
    if (!array_grow(&r->used_line, before, &r->lines_capacity, sizeof *r->used_line, 0)) return out_of_memory(r);
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
    size_t n = rest_of_line(p);
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
                ok = array_grow(&m->material, m->n_materials, &capacity, sizeof *m->material, 0);
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
    give_back(r);
    uint32_t before = m->n_triangles;
    double (*position)[3] = r->position;
    r->position = NULL;
    const char *wrong = mesh_finish(m, position, r->polygon, r->n_polygons);
    if (wrong) return report_error(r->report, path, 0, "%s", wrong);
    if (m->n_triangles < before) report_warning(r->report, path, 0, "%u triangles without area are dropped", (unsigned)(before - m->n_triangles));
    if (m->n_triangles == 0) return report_error(r->report, path, 0, "no geometry: no face has an area");
    if (!bind_materials(r)) return false;
    if (!mesh_finish_uvs(m)) return out_of_memory(r);
    mesh_trim(m);
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
