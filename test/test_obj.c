/* The OBJ, MTL and SCENE.cam readers: what is accepted, what is refused and with which words, numbers against strtod, triangulation by area,
 * what is kept and what is not. */
#include "check.h"
#include "folder.h"
#include "../obj.h"
#include "../rng.h"
#include "../text.h"
#include <locale.h>
#include <sys/resource.h>
#include <sys/stat.h>

/* What a read has given. */
typedef struct {
    bool ok;
    Mesh mesh;
    char error[1024], warnings[8192];
    int warned;
} Result;

static Result read_file(const char *name)
{
    Result r = { 0 };
    FILE *f = fopen(folder_path("warnings"), "wb+");
    Report report = { .warnings = f };
    r.ok = obj_read(&r.mesh, folder_path(name), &report);
    snprintf(r.error, sizeof r.error, "%s", report.error);
    r.warned = report.warned;
    rewind(f);
    r.warnings[fread(r.warnings, 1, sizeof r.warnings - 1, f)] = 0;
    fclose(f);
    return r;
}

static Result read_obj(const char *text)
{
    folder_write_text("a.obj", text);
    return read_file("a.obj");
}

/* Rows of input and outcome. */

#define V4 "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
#define T4 "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
#define N1 "vn 0 0 1\n"
#define BYTES(text) text, sizeof(text) - 1
#define FACE "f 1 2 3\n"

/* triangles: how many, or REFUSED. words: part of the error or of the warnings; NULL: no warning may come. */
enum { REFUSED = -1 };
typedef struct { const char *text; size_t n; int triangles; const char *words; } Row;

static const Row rows[] = {
    /* indices */
    { BYTES(V4 "f 1 2 3\n"), 1, NULL },
    { BYTES(V4 "f -4 -3 -2\n"), 1, NULL },
    { BYTES(V4 "f -4 -3 -2\nv 9 9 9\nf -5 -4 -3\n"), 2, NULL },
    { BYTES(V4 N1 "f -4//-1 -3//-1 -2//-1\n"), 1, NULL },
    { BYTES(V4 "f -5 -2 -1\n"), REFUSED, "a.obj:5: vertex index -5 is out of range" },
    { BYTES("f -1 -2 -3\n" V4), REFUSED, "a.obj:1: vertex index -1" },
    { BYTES(V4 "f 0 1 2\n"), REFUSED, "a.obj:5: vertex index 0" },
    { BYTES(V4 FACE "\nf 1 2 5\n"), REFUSED, "a.obj:7: vertex index 5 is out of range: the file has 4 vertices" },
    { BYTES("f 1 2 3\n" V4), 1, NULL },
    { BYTES(V4 N1 "f 1//1 2//1 3//1\n"), 1, NULL },
    { BYTES(V4 T4 "f 1/1 2/2 3/3\n"), 1, NULL },
    { BYTES(V4 T4 N1 "f 1/1/1 2/2/1 3/3/1\n"), 1, NULL },
    { BYTES(V4 "f 1/ 2/ 3/\n"), 1, NULL },
    { BYTES(V4 "f 1// 2// 3//\n"), 1, NULL },
    { BYTES(V4 T4 "f 1/1/ 2/2/ 3/3/\n"), 1, NULL },
    { BYTES(V4 T4 N1 "f 1/1/1 2//1 3\n"), 1, NULL },
    { BYTES(V4 "f 1/9 2/9 3/9\n"), 1, "a.obj:5: indices of normals or texture coordinates out of range" },
    { BYTES(V4 N1 "f 1//2 2//3 3//4\n"), 1, "a.obj:6: indices of normals" },
    { BYTES(V4 N1 "f 1//-2 2//1 3//1\n"), 1, "a.obj:6: indices of normals" },
    { BYTES(V4 "f 1/0/0 2/0/0 3/0/0\n"), 1, "a.obj:5: indices of normals or texture coordinates out of range (6 times)" },
    { BYTES(V4 "f 1 2 99999999999999999999\n"), REFUSED, "a.obj:5: vertex index 99999999999999999999" },
    { BYTES(V4 "f 1 2 4294967297\n"), REFUSED, "a.obj:5:" },
    { BYTES(V4 "f 1 2 4294967295\n"), REFUSED, "a.obj:5:" },
    { BYTES(V4 "f 1 2 -2147483648\n"), REFUSED, "a.obj:5:" },
    { BYTES(V4 "f 1 2 3a\n"), REFUSED, "a.obj:5: '3a' is not a corner" },
    { BYTES(V4 "f 1 2 3.0\n"), REFUSED, "a.obj:5: '3.0'" },
    { BYTES(V4 "f +1 +2 +3\n"), 1, NULL },
    { BYTES(V4 "f a b c\n"), REFUSED, "a.obj:5: 'a' is not" },
    { BYTES(V4 "f 1 /1 /1 2 3\n"), REFUSED, "a.obj:5: '/1'" },
    { BYTES(V4 "f 001 0000000002 00000000000000000000000000003\n"), 1, NULL },
    { BYTES(V4 T4 N1 "f 1/1/1/7 2/2/1/7 3/3/1/7\n"), REFUSED, "a.obj:10: '1/1/1/7'" },
    { BYTES(V4 "f 1 2 -\n"), REFUSED, "a.obj:5: '-'" },
    { BYTES(V4 "f 1/x 2 3\n"), REFUSED, "a.obj:5: '1/x'" },
    { BYTES(V4 "f 1 2 3,4\n"), REFUSED, "a.obj:5: '3,4'" },
    /* faces */
    { BYTES(V4 FACE "f\nf \n"), 1, "a.obj:6: faces with fewer than three corners are dropped (2 times)" },
    { BYTES(V4 FACE "f 1\nf 1 2\n"), 1, "fewer than three" },
    { BYTES(V4 "f 1 2\n"), 0, "fewer than three" },
    { BYTES(V4 "f 1 2 3 4\n"), 2, NULL },
    { BYTES(V4 "v 0.5 2 0\nf 1 2 3 5 4\n"), 3, NULL },
    { BYTES(V4 FACE "f 1 1 2\n"), 1, "a.obj: 1 triangles without area are dropped" },
    { BYTES(V4 FACE "f 1 1 1\n"), 1, "without area" },
    { BYTES("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 4\n"), 1, "without area" },
    { BYTES("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"), REFUSED, "no face has an area" },
    { BYTES("v 7 7 7\nv 7 7 7\nv 7 7 7\nf 1 2 3\n"), REFUSED, "no face has an area" },
    { BYTES("v 0 0 0\nv 1 0 0\nv 1 1 1\nv 0 1 0\nf 1 2 3 4\n"), 2, NULL },
    { BYTES(V4 "f 1 3 2 4\n"), 2, NULL },
    { BYTES(V4 "fo 1 2 3\n"), 1, NULL },
    { BYTES(V4 FACE "f1 2 3\n"), 1, "a.obj:6: unknown keyword 'f1'" },
    { BYTES(V4 FACE "v1 2 3\n"), 1, "unknown keyword 'v1'" },
    { BYTES(V4 FACE "V 1 2 3\nF 1 2 3\nF 2 3 4\n"), 1, "a.obj:7: unknown keyword 'F' (2 times)" },
    /* lines, blanks, bytes */
    { BYTES("v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nf 1 2 3\r\n"), 1, NULL },
    { BYTES("v 0 0 0\rv 1 0 0\rv 1 1 0\rf 1 2 3\r"), 1, NULL },
    { BYTES("v 0 0 0\rv 1 0 0\r\nv 1 1 0\n\rf 1 2 3\n"), 1, NULL },
    { BYTES("v 0 0 0\rv 1 0 0\r\nv 1 1 0\n\rf 1 2 x\n"), REFUSED, "a.obj:5:" },
    { BYTES(V4 "f 1 \\\n2 \\\r\n3\n"), 1, NULL },
    { BYTES(V4 "f 1 \\  \t\n2 3\n"), 1, NULL },
    { BYTES(V4 "f 1 2 3\\\n4\nf 1 2 9\n"), REFUSED, "a.obj:7:" },
    { BYTES(V4 "f 1 2 3\\\n4\n"), 2, NULL },
    { BYTES(V4 "f 1 2 3\\"), 1, NULL },
    { BYTES(V4 "f 1 2 3 \\\n"), 1, NULL },
    { BYTES(V4 "f 1 2 \\ 3\n"), REFUSED, "a.obj:5: a backslash inside a line" },
    { BYTES("v 1 2 \\ 3\n"), REFUSED, "a.obj:1: a backslash" },
    { BYTES("vn 1 2 \\ 3\nvt 1 \\ 2\n"), REFUSED, "a.obj:1: a backslash" },
    { BYTES("v 0 \\\n0 0\nv\\\n 1 0 0\n\\\nv 1 1 \\\n\\\n\\\n 0\nf 1 2 3\nf 1 2 4\n"), REFUSED, "a.obj:11:" },
    { BYTES("v 0 \\\n0 0\nv\\\n 1 0 0\n\\\nv 1 1 \\\n\\\n\\\n 0\nf 1 2 3\n"), 1, NULL },
    { BYTES(V4 T4 N1 "vn 0 0\\\n 1\nvt 1\\\n 1\nvt \\\n1\nf 1/-1/-1 2/-1/-1 3/-1/-1\n"), 1, NULL },
    { BYTES(V4 "# a path C:\\models\\\nf 1 2 3\n"), 1, NULL },
    { BYTES(V4 "f 1 2 3 # C:\\models\\\nf 1 2 4\n"), 2, NULL },
    { BYTES("\tv\t0\t0 0 \t\n v 1 0 0 \n  v 1 1 0\n\t f 1 2 3   \n"), 1, NULL },
    { BYTES(V4 "f 1 2 3"), 1, NULL },
    { BYTES("v 0 0 0 # a\nv 1 0 0#b\nv 1 1 0\nf 1 2 3#4\n"), 1, NULL },
    { BYTES(""), REFUSED, "a.obj: no geometry" },
    { BYTES("\n\n  \n"), REFUSED, "no geometry" },
    { BYTES("# nothing\n"), REFUSED, "no geometry" },
    { BYTES(V4), REFUSED, "no geometry" },
    { BYTES("\0v 0 0 0\n"), REFUSED, "a.obj:1: binary data" },
    { BYTES("v 0 0 0\nv 1\0 0 0\n"), REFUSED, "a.obj:2:" },
    { BYTES("v 0 0 0\nusemtl a\0b\n"), REFUSED, "a.obj:2: binary" },
    { BYTES("\xef\xbb\xbf" V4 FACE), 1, NULL },
    { BYTES("\xff\xfev\0 \0" "0\0"), REFUSED, "a.obj: UTF-16" },
    { BYTES("\xfe\xff\0v\0 \0" "0"), REFUSED, "a.obj: UTF-16" },
    { BYTES("v\0 \0" "0\0 \0"), REFUSED, "a.obj:1: binary" },
    { BYTES("v\f0\v0 0\nv 1 0 0\nv 1 1 0\nf 1\f2\v3\n"), 1, NULL },
    { BYTES("v 0\xc2\xa0" "0 0\n"), REFUSED, "a.obj:1: '0\xc2\xa0" "0' is not a number" },
    { BYTES(V4 "v 1 1 -"), REFUSED, "a.obj:5: '-' is not a number" },
    { BYTES(V4 FACE "f 1/"), 1, "a.obj:6: faces with fewer" },
    { BYTES(V4 FACE "user"), 1, "unknown keyword 'user'" },
    { BYTES("\x89PNG\r\n\x1a\n...\x01\x02"), REFUSED, "a.obj: not an OBJ file" },
    { BYTES("hello\nworld\n"), REFUSED, "not an OBJ file" },
    { BYTES(V4 FACE "\x1a"), 1, NULL },
    /* numbers */
    { BYTES("v 1e0 1E+0 1e-05\nv .5 5. -.5\nv +1 -0 1.e1\nf 1 2 3\n"), 1, NULL },
    { BYTES("v 1e39 0 0\nv 0 1e39 0\nv 0 0 0\nf 1 2 3\n"), 1, NULL },
    { BYTES("v 1e300 0 0\nv 0 1e300 0\nv -1e300 0 0\nf 1 2 3\n"), 1, NULL },
    { BYTES("v 1.7e308 0 0\nv 0 1.7e308 0\nv -1.7e308 0 0\nf 1 2 3\n"), REFUSED, "too large" },
    { BYTES("v 1e-320 0 0\nv 0 1e-320 0\nv 0 0 0\nf 1 2 3\n"), REFUSED, "too small" },
    { BYTES("v 1e-200 0 0\nv 0 1e-200 0\nv 0 0 0\nf 1 2 3\n"), 1, NULL },
    { BYTES("v 1e400 0 0\n"), REFUSED, "a.obj:1: '1e400' is too large" },
    { BYTES("v 1e99999999999 0 0\n"), REFUSED, "a.obj:1: '1e99999999999' is too large" },
    { BYTES("v 0e99999999999 0 1e-99999999999\nv 1 0 0\nv 0 1 0\n" FACE), 1, NULL },
    { BYTES("v nan 0 0\n"), REFUSED, "a.obj:1: 'nan' is not a number" },
    { BYTES("v 0 -inf 0\n"), REFUSED, "'-inf' is not" },
    { BYTES("v 1.#INF 0 0\n"), REFUSED, "a.obj:1: the line ends" },
    { BYTES("v -nan(ind) 0 0\n"), REFUSED, "is not a number" },
    { BYTES("v 0x10 0 0\n"), REFUSED, "'0x10'" },
    { BYTES("v 0 0 0,5\n"), REFUSED, "a.obj:1: '0,5' has a decimal comma" },
    { BYTES("v 1e 0 0\n"), REFUSED, "'1e' is not" },
    { BYTES("v 1e+ 0 0\n"), REFUSED, "'1e+'" },
    { BYTES("v 1d5 0 0\n"), REFUSED, "'1d5'" },
    { BYTES("v 1 2\n"), REFUSED, "a.obj:1: the line ends" },
    { BYTES("v 1\n"), REFUSED, "the line ends" },
    { BYTES("v\n"), REFUSED, "the line ends" },
    { BYTES(V4 FACE "v 1 2 3 4 5 6 7 8 9\n"), 1, "a.obj:6: more values than a vertex can have" },
    { BYTES("v a b c\n"), REFUSED, "'a' is not" },
    { BYTES("v --1 0 0\n"), REFUSED, "'--1'" },
    { BYTES("v 1-2 0 0\n"), REFUSED, "'1-2'" },
    { BYTES("v 1.2.3 0 0\n"), REFUSED, "'1.2.3'" },
    { BYTES("v 1'000 0 0\n"), REFUSED, "'1'000'" },
    { BYTES("v 1_000 0 0\n"), REFUSED, "'1_000'" },
    { BYTES("v . 0 0\n"), REFUSED, "'.'" },
    { BYTES("v 123456789.123456789 0 0\nv 0.1234567890123456789012 12345678 1\nv 0 0 .12345678\n" FACE), 1, NULL },
    /* extras of v, vt, vn */
    { BYTES("v 0 0 0 1 0.5 0\nv 1 0 0 1 1 1\nv 1 1 0\n" FACE), 1, "a.obj:1: vertex colours are ignored (2 times)" },
    { BYTES("v 0 0 0 1\nv 1 0 0 1.0\nv 1 1 0 1\n" FACE), 1, NULL },
    { BYTES("v 0 0 0 1\nv 1 0 0 2\nv 1 1 0 1\n" FACE), 1, "a.obj:2: the weight w" },
    { BYTES("v 0 0 0 255 0 0\nv 1 0 0 1 0 0 1\nv 1 1 0\n" FACE), 1, "vertex colours" },
    { BYTES("v 0 0 0 nan 0 0\nv 1 0 0\nv 1 1 0\n" FACE), 1, "extra values of a vertex" },
    { BYTES(V4 "vt 0\nvt 0 1\nvt 0 1 2\nvt 0.5#\nf 1/1 2/2 3/3\n"), 1, NULL },
    { BYTES(V4 "vt x\nf 1/1 2/1 3/1\n"), 1, "a.obj:5: texture coordinates that cannot be read" },
    { BYTES(V4 "vt 1e39 0\nf 1/1 2/1 3/1\n"), 1, "texture coordinates that cannot" },
    { BYTES(V4 "vn 0 1\nf 1//1 2//1 3//1\n"), 1, "a.obj:5: normals that cannot be read" },
    { BYTES(V4 "vn 0 0 0\nf 1//1 2//1 3//1\n"), 1, "a.obj:5: normals without a direction" },
    { BYTES(V4 "vn 0 0 1e-9\nf 1//1 2//1 3//1\n"), 1, "normals without a direction" },
    { BYTES(V4 "vn nan 0 0\nf 1//1 2//1 3//1\n"), 1, "normals that cannot" },
    { BYTES(V4 "vn 0 0 1e200\nf 1//1 2//1 3//1\n"), 1, "normals without a direction" },
    { BYTES(V4 "vp 1 2\nvw 1\n" FACE), 1, NULL },
    /* groups and other elements */
    { BYTES(V4 "g a b c\ng\ng a b c\n" FACE), 1, NULL },
    { BYTES(V4 "o my object \no\n" FACE), 1, NULL },
    { BYTES(V4 "s 1\ns off\ns 0\ns on\ns\ns -1\ns 99999999999\n" FACE), 1, NULL },
    { BYTES(V4 "s foo\n" FACE), 1, "a.obj:5: smoothing group" },
    { BYTES(V4 "l 1 2\nl 9/9 0\n" FACE), 1, "a.obj:5: lines are not rendered (2 times)" },
    { BYTES(V4 "p 1\np\n" FACE), 1, NULL },
    { BYTES(V4 "cstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\nparm u 0 1\nend\n" FACE), 1, "a.obj:5: curves and surfaces are not supported (5 times)" },
    { BYTES(V4 "bevel on\nc_interp on\nd_interp on\nlod 1\nctech x\nstech y\nmg 1 2\n" FACE), 1, NULL },
    { BYTES(V4 "csh rm x\n" FACE), 1, "not supported and ignored: 'csh'" },
    { BYTES(V4 "call a.obj\ncall a.obj\n" FACE), 1, "ignored: 'call' (2 times)" },
    { BYTES(V4 "shadow_obj a\ntrace_obj a\nmaplib m\nusemap x\n" FACE), 1, "'shadow_obj'" },
    /* materials by name */
    { BYTES(V4 "usemtl nosuch\n" FACE), 1, "a.obj:5: unknown material, 0.5 grey is used: 'nosuch'" },
    { BYTES(V4 "mtllib m.mtl\nusemtl RED\n" FACE), 1, "unknown material, 0.5 grey is used: 'RED'" },
    { BYTES(V4 "mtllib nosuch.mtl\n" FACE), 1, "a.obj:5: material library not found: 'nosuch.mtl'" },
    { BYTES(V4 "mtllib m.mtl\nusemtl red\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib m.mtl\nusemtl my red \t\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib m.mtl m2.mtl\nusemtl green\n" FACE "usemtl red\nf 1 3 4\n"), 2, NULL },
    { BYTES(V4 "mtllib m.mtl nosuch.mtl\nusemtl red\n" FACE), 1, "not found: 'nosuch.mtl'" },
    { BYTES(V4 "mtllib m.mtl\nmtllib m.mtl\nmtllib m2.mtl\nusemtl green\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib my lib.mtl\nusemtl spaced\n" FACE), 1, NULL },
    { BYTES(V4 "usemtl red\n" FACE "mtllib m.mtl\n"), 1, NULL },
    { BYTES(V4 "usemtl\n" FACE), 1, "a.obj:5: usemtl without a name" },
    { BYTES(V4 "mtllib\n" FACE), 1, "a.obj:5: mtllib without a file" },
    { BYTES(V4 "mtllib .\\m.mtl\nusemtl red\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib \"m.mtl\"\nusemtl red\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib \"my lib.mtl\" # c\nusemtl spaced\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib sub\n" FACE), 1, "not found: 'sub'" },
    { BYTES(V4 "mtllib a.obj\n" FACE), 1, "a.obj: no new material in this file" },
    { BYTES("v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nmtllib m.mtl\r\nusemtl red\r\nf 1 2 3\r\n"), 1, NULL },
    { BYTES(V4 "mtllib m.mtl # c\nusemtl red # c\n" FACE), 1, NULL },
    { BYTES(V4 "mtllib m.mtl\nusemtl hash # 1\n" FACE), 1, NULL },
};

static void test_rows(void)
{
    folder_write_text("m.mtl", "newmtl red\nKd 1 0 0\nnewmtl my red\nKd 1 0 0\nnewmtl hash # 1\nKd 0 0 1\n");
    folder_write_text("m2.mtl", "newmtl green\nKd 0 1 0\nnewmtl red\nKd 0 0 0\n");
    folder_write_text("my lib.mtl", "newmtl spaced\nKd 1 1 1\n");
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        const Row *row = &rows[i];
        folder_write("a.obj", row->text, row->n);
        Result r = read_file("a.obj");
        bool right;
        if (row->triangles == REFUSED) right = !r.ok && strstr(r.error, row->words) && !strchr(r.error, '\n');
        else if (row->triangles == 0) right = !r.ok && strstr(r.error, "no geometry") && strstr(r.warnings, row->words);
        else right = r.ok && r.mesh.n_triangles == (uint32_t)row->triangles && (row->words ? strstr(r.warnings, row->words) != NULL : r.warned == 0);
        if (!CHECK(right))
            printf("  row %zu: %s\n  read %d, %u triangles, error '%s', warnings '%s'\n", i, row->text, r.ok, (unsigned)r.mesh.n_triangles, r.error,
                   r.warnings);
        for (uint32_t k = 0; r.ok && k < r.mesh.n_triangles; k++)
            for (int c = 0; c < 3; c++) CHECK(r.mesh.triangle[k][c] < r.mesh.n_positions);
        mesh_free(&r.mesh);
    }
    remove(folder_path("m.mtl"));
    remove(folder_path("m2.mtl"));
    remove(folder_path("my lib.mtl"));
}

/* Files that cannot be opened, and what crosses the blocks in which files are read. */

static void test_files(void)
{
    Result r = read_file("no such file.obj");
    CHECK(!r.ok && strstr(r.error, "no such file.obj: No such file"));
    r = read_file("sub");
    CHECK(!r.ok && strstr(r.error, "directory"));
    r = read_file("a.obj/b.obj");
    CHECK(!r.ok && strstr(r.error, "b.obj: "));

    /* A line end that lies in two blocks is still one, wherever it falls; so is a joined line. */
    enum { BLOCK = 1 << 18 };
    static char text[BLOCK + 400];
    static const char *const ends[] = { "\n", "\r\n", "\r", " \\\n \\\r\n\n", " # \\\r\n" };
    for (size_t e = 0; e < sizeof ends / sizeof ends[0]; e++)
        for (int shift = 0; shift < 48; shift += e < 3 ? 3 : 1) {
            size_t n = (size_t)sprintf(text, "#");
            while (n < BLOCK - 40) text[n++] = 'x';
            for (int i = 0; i < shift; i++) text[n++] = 'y';
            n += (size_t)sprintf(text + n, "%sv 0 0 0%sv 1 0 0%sv 0 1 0%sf 1 2 3%sf 1 2 x%s", "\n", ends[e], ends[e], ends[e], ends[e], ends[e]);
            folder_write("a.obj", text, n);
            r = read_file("a.obj");
            const char *expected = e == 3 ? ":14: 'x'" : ":6: 'x'";
            if (!CHECK(!r.ok && strstr(r.error, expected))) printf("  %zu %d: %s\n", e, shift, r.error);
            mesh_free(&r.mesh);
        }

    /* lines longer than a block */
    size_t big = 2u << 20;
    char *long_text = malloc(big + 400);
    size_t n = (size_t)sprintf(long_text, V4 "#");
    memset(long_text + n, 'c', big);
    n += big;
    n += (size_t)sprintf(long_text + n, "\n" FACE);
    folder_write("a.obj", long_text, n);
    r = read_file("a.obj");
    CHECK(r.ok && r.warned == 0 && r.mesh.n_triangles == 1);
    mesh_free(&r.mesh);
    memcpy(long_text + strlen(V4), "usemtl ", 7);
    folder_write("a.obj", long_text, n);
    r = read_file("a.obj");
    CHECK(r.ok && r.warned == 1 && strlen(r.warnings) < 500);
    mesh_free(&r.mesh);
    for (int library = 0; library < 2; library++) {    /* names that might end in many places */
        n = strlen(V4) + (size_t)sprintf(long_text + strlen(V4), library ? "mtllib " : "usemtl ");
        while (n < big / 4) n += (size_t)sprintf(long_text + n, "a # ");
        sprintf(long_text + n, "\n" FACE);
        folder_write_text("a.obj", long_text);
        r = read_file("a.obj");
        CHECK(r.ok && r.warned == 1);
        mesh_free(&r.mesh);
    }
    memset(long_text, '1', big);
    memcpy(long_text, "v ", 2);
    memcpy(long_text + big, " 0 0\n", 6);
    folder_write_text("a.obj", long_text);
    r = read_file("a.obj");
    CHECK(!r.ok && strstr(r.error, "is too large") && strlen(r.error) < 500);
    free(long_text);

    /* many kinds of warnings: capped */
    static char many[40000];
    n = (size_t)sprintf(many, V4 FACE);
    for (int i = 0; i < 1000; i++) n += (size_t)sprintf(many + n, "kind%d\n", i);
    r = read_obj(many);
    CHECK(r.ok && r.warned <= 50);
    mesh_free(&r.mesh);
}

/* Numbers against strtod, which is correctly rounded in the libraries this is tested with. */

static uint64_t bits_of(double x)
{
    uint64_t u;
    memcpy(&u, &x, sizeof u);
    return u;
}

static int wrong_numbers;

static void check_number(const char *text)
{
    double value = 12345, expected = strtod(text, NULL);
    bool ok = parse_double(text, strlen(text), &value);
    if (ok == (bool)isfinite(expected) && (!ok || bits_of(value) == bits_of(expected))) return;
    if (wrong_numbers++ < 10) printf("  %s: %d %.17g, not %.17g\n", text, ok, value, expected);
}

static uint32_t below(Rng *rng, uint32_t n) { return (uint32_t)(rng_double(rng) * n); }

static void test_numbers(void)
{
    static const char *const hard[] = {
        "0", "-0", "0.0", "0e5", "1", "9007199254740992", "9007199254740993", "9007199254740993.0000000000000000000000000000001",
        "9007199254740992.9999999999999999999999999", "9007199254740995", "18446744073709551615", "18446744073709551616", "99999999999999999999",
        "1e22", "1e23", "8.5e22", "1e-22", "1e-23", "3e-23", "123456789012345678e-19", "1.7976931348623157e308", "1.7976931348623158e308",
        "1.7976931348623159e308", "179769313486231580793e288", "1e308", "1e309", "-1e400", "2.2250738585072014e-308", "2.2250738585072011e-308",
        "2.2250738585072012e-308", "4.9406564584124654e-324", "2.4703282292062327e-324", "2.4703282292062328e-324", "1e-323", "1e-324", "1e-400",
        "3.4028235e38", "1.17549435e-38", "0.1", "0.3", "0.500000000000000166533453693773481063544750213623046875",
        "1.00000000000000011102230246251565404236316680908203125", "1.00000000000000011102230246251565404236316680908203124",
        "1.00000000000000011102230246251565404236316680908203126", "6929495644600919.5", "3.7455744005952583e15", "1.0e+00000000000000000010",
        "000000000000000000000000000000000000000000000000000123.4500000000000000000000000000000000000000000000000", "0.000000000000000000000000001",
        "12345678", "123456789", "1234567.12345678", "1234567.1234567890123456", ".12345678", "0.12345678901234567", "1e-5", "1.e5", ".5", "5.", "+1"
    };
    static const char *const none[] = { "", " ", "1 ", " 1", "-", "+", ".", "-.", "e5", ".e5", "1e", "1e+", "1e+-5", "--1", "+-1", "1-2", "1.2.3",
        "nan", "inf", "-inf", "infinity", "0x10", "0,5", "1d5", "1'000", "1_000", "1.#INF", "1f", "1e5.0", "1e400", "1e99999999999999999999999" };
    double value;
    for (size_t i = 0; i < sizeof hard / sizeof hard[0]; i++) check_number(hard[i]);
    for (size_t i = 0; i < sizeof none / sizeof none[0]; i++)
        if (!CHECK(!parse_double(none[i], strlen(none[i]), &value))) printf("  %s\n", none[i]);
    CHECK(!parse_double("1\0", 2, &value));
    CHECK(parse_double("1.25x", 4, &value) && value == 1.25);
    CHECK(parse_double("0e99999999999999999999", 22, &value) && value == 0);

    /* digits without end */
    static char digits[5000];
    for (int zeros = 0; zeros < 4000; zeros += 137) {
        int n = sprintf(digits, "0.");
        for (int i = 0; i < zeros; i++) digits[n++] = '0';
        n += sprintf(digits + n, "17");
        sprintf(digits + n, "e%d", zeros);
        check_number(digits);
        n = sprintf(digits, "9007199254740993");
        for (int i = 0; i < zeros; i++) digits[n++] = '0';
        if (zeros % 2) digits[n++] = '1';
        sprintf(digits + n, "e-%d", zeros);
        check_number(digits);
        n = sprintf(digits, "9007199254740993.");
        for (int i = 0; i < zeros; i++) digits[n++] = '0';
        digits[n++] = '1';
        digits[n] = 0;
        check_number(digits);
    }

    Rng rng = rng_new(1, 0);
    char text[2000];
    for (int i = 0; i < 1000000; i++) {
        uint64_t u = (uint64_t)below(&rng, UINT32_MAX) << 32 | below(&rng, UINT32_MAX);
        double d;
        memcpy(&d, &u, sizeof d);
        switch (i % 8) {
        case 0: snprintf(text, sizeof text, "%.17g", isfinite(d) ? d : 1); break;
        case 1: snprintf(text, sizeof text, "%d.%06u", (int)below(&rng, 20000) - 10000, (unsigned)below(&rng, 1000000)); break;
        case 2: snprintf(text, sizeof text, "%.16g", 200 * rng_double(&rng) - 100); break;
        case 3: snprintf(text, sizeof text, "%llue%d", (unsigned long long)u, (int)below(&rng, 660) - 340); break;
        case 4: snprintf(text, sizeof text, "%llu.%llue%d", (unsigned long long)u >> below(&rng, 64), (unsigned long long)u, (int)below(&rng, 60) - 30); break;
        case 5: snprintf(text, sizeof text, "%.*f", (int)below(&rng, 20), 2 * rng_double(&rng) - 1); break;
        case 6: snprintf(text, sizeof text, "%llu", (unsigned long long)(u >> 10 | 1)); break;      /* half way between two doubles, or near */
        default:                                                                                      /* exactly half way, or a little beside */
            if (i % 16 != 7 || LDBL_MANT_DIG < 64) {
                snprintf(text, sizeof text, "%.9e", isfinite(d) ? d : 1);
                break;
            }
            d = ldexp(1 + rng_double(&rng), (int)below(&rng, 200) - 100);
            int n = snprintf(text, sizeof text, "%.400Lf", (long double)d + ldexpl(1, ilogb(d) - 53));
            if (i & 16) text[n - 1]++;
        }
        check_number(text);
    }
    CHECK(wrong_numbers == 0);

    /* a locale with a decimal comma changes nothing */
    if (setlocale(LC_NUMERIC, "de_DE.UTF-8") || setlocale(LC_NUMERIC, "fr_FR.UTF-8")) {
        CHECK(parse_double("0.5", 3, &value) && value == 0.5);
        CHECK(!parse_double("0,5", 3, &value));
        setlocale(LC_NUMERIC, "C");
    }
}

/* The two ways to find the end of the digits agree with the plain one. */
static void test_digits(void)
{
    char text[32] = "";
    int wrong = 0;
    Rng rng = rng_new(2, 0);
    for (int i = 0; i < 200000; i++) {
        unsigned expected_n = 0;
        uint64_t expected = 0, value;
        for (int k = 0; k < 16; k++) text[k] = (char)(below(&rng, 8) ? '0' + (int)below(&rng, 10) : (int)below(&rng, 256));
        while (expected_n < 8 && text[expected_n] >= '0' && text[expected_n] <= '9') expected = expected * 10 + (uint64_t)(text[expected_n++] - '0');
        wrong += scan_digits(text, &value) != expected_n || value != expected;
    }
    CHECK(wrong == 0);
}

/* What is read quickly is what is read slowly, and most lines are. */
static void test_quick(void)
{
    char memory[TEXT_MARGIN + 400] = "", *text = memory + TEXT_MARGIN;
    int wrong = 0, quick[2] = { 0, 0 };
    Rng rng = rng_new(3, 0);
    for (int i = 0; i < 200000; i++) {
        int most = 1 + (int)below(&rng, 3), n = 0;
        double value[3];
        for (int k = 0; k < most; k++) {
            static const double size[] = { 1, 100, 1e6, 1e8 };
            n += sprintf(text + n, "%.*f%c", (int)below(&rng, i % 4 ? 9 : 18), (2 * rng_double(&rng) - 1) * size[below(&rng, i % 4 ? 3 : 4)],
                         k < most - 1 || i % 5 ? ' ' : '\n');
            if (i % 7 == 0) text[below(&rng, (uint32_t)n)] = "0-+.e /\n"[below(&rng, 8)];
        }
        memset(text + n, '7', 80);
        char *end = numbers_scan(text, most, value), *p = text;
        if (!end) continue;
        quick[0]++;
        for (int k = 0; k < most; k++) {
            char *after;
            double expected = strtod(p, &after);
            wrong += after == p || bits_of(value[k]) != bits_of(expected) || (k < most - 1 ? *after != ' ' : !is_token_end(*after) || after != end);
            p = after + 1;
        }
    }
    for (int i = 0; i < 200000; i++) {
        uint32_t written[3] = { 0, 0, 0 }, read[3] = { 0, 0, 0 };
        for (int k = 0; k < 3; k++) written[k] = below(&rng, (uint32_t)POWER_OF_TEN[below(&rng, 10)]);
        int form = (int)below(&rng, 4);
        int n = form == 0 ? sprintf(text, "%u ", (unsigned)written[0]) : form == 1 ? sprintf(text, "%u/%u\n", (unsigned)written[0], (unsigned)written[1])
              : form == 2 ? sprintf(text, "%u//%u ", (unsigned)written[0], (unsigned)written[2])
              : sprintf(text, "%u/%u/%u\n", (unsigned)written[0], (unsigned)written[1], (unsigned)written[2]);
        memset(text + n, '/', 80);
        char *end = indices_scan(text, read);
        bool has[3] = { true, (form & 1) != 0, form >= 2 }, possible = true;
        for (int k = 0; k < 3; k++) possible = possible && (!has[k] || (written[k] > 0 && written[k] < 100000000));
        if (!end) continue;
        quick[1]++;
        wrong += !possible || end != text + n - 1;
        for (int k = 0; k < 3; k++) wrong += read[k] != (has[k] ? written[k] : 0);
    }
    CHECK(wrong == 0);
    CHECK((quick[0] == 0 && quick[1] == 0) || (quick[0] > 100000 && quick[1] > 100000));        /* none where there are no vector operations */
}

/* Positions. */

static void test_scale(void)
{
    Result r = read_obj("v 1 2 3\nv 5 2 3\nv 1 4 3\nv 1000 1000 1000\n" FACE);
    CHECK(r.ok && r.mesh.n_positions == 3);            /* the far vertex has no face */
    CHECK(r.mesh.centre.x == 3 && r.mesh.centre.y == 3 && r.mesh.centre.z == 3 && r.mesh.unit == 2);
    CHECK((double)r.mesh.position[0][0] == -1 && (double)r.mesh.position[1][0] == 1 && (double)r.mesh.position[2][1] == 0.5);
    mesh_free(&r.mesh);

    r = read_obj("v 1 2 3 \\\n 1\nv 5 2 3\\\n\nv 1 4 3 \\\n # c\nvn 0 0 1\\\n\nvt 1 1 \\\n\nf 1//1 2//1 \\\n 3//1\n");     /* joined lines count once */
    CHECK(r.ok && r.warned == 0 && r.mesh.n_triangles == 1 && r.mesh.centre.x == 3 && r.mesh.centre.y == 3);
    CHECK((double)r.mesh.position[1][0] == 1 && (double)r.mesh.position[2][1] == 0.5);
    mesh_free(&r.mesh);

    /* Scaling by a power of two changes centre and unit and nothing else; far from the origin no position leaves the cube. */
    Rng rng = rng_new(3, 0);
    static double v[600][3];
    static char text[80000];
    Mesh first = { 0 };
    for (int round = 0; round < 2; round++) {
        for (int i = 0; i < 600; i++)
            for (int k = 0; k < 3; k++) v[i][k] = round ? 1e15 + below(&rng, 3) * 0.125 : 100 * rng_double(&rng) - 30;
        static const int exponents[] = { 0, 1, -1, 7, -30, 400, -500 };
        for (size_t e = 0; e < sizeof exponents / sizeof exponents[0]; e++) {
            double s = ldexp(1, exponents[e]);
            int n = 0;
            for (int i = 0; i < 600; i++) n += sprintf(text + n, "v %.17g %.17g %.17g\n", s * v[i][0], s * v[i][1], s * v[i][2]);
            for (int i = 0; i < 200; i++) n += sprintf(text + n, "f %d %d %d %d\n", i + 1, i + 2, i + 201, i + 350);
            n += sprintf(text + n, "f");
            for (int i = 400; i < 450; i++) n += sprintf(text + n, " %d", i);
            r = read_obj(text);
            CHECK(r.ok);
            int outside = 0;
            for (uint32_t i = 0; i < r.mesh.n_positions; i++)
                for (int k = 0; k < 3; k++) outside += !(fabsf(r.mesh.position[i][k]) <= 1);
            CHECK(outside == 0);
            if (e == 0) {
                mesh_free(&first);
                first = r.mesh;
                continue;
            }
            CHECK(r.mesh.n_positions == first.n_positions && r.mesh.n_triangles == first.n_triangles);
            CHECK(memcmp(r.mesh.position, first.position, first.n_positions * sizeof *first.position) == 0);
            CHECK(memcmp(r.mesh.triangle, first.triangle, first.n_triangles * sizeof *first.triangle) == 0);
            CHECK(r.mesh.unit == s * first.unit && r.mesh.centre.x == s * first.centre.x && r.mesh.centre.z == s * first.centre.z);
            mesh_free(&r.mesh);
        }
    }
    mesh_free(&first);
}

/* Polygons: a triangulation of a flat simple polygon has the polygon's area. */

typedef struct { double x, y; } Point2;

static double polygon_area(const Point2 *p, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++) sum += p[i].x * p[(i + 1) % n].y - p[(i + 1) % n].x * p[i].y;
    return fabs(sum) / 2;
}

static double fan_area(const Point2 *p, int n)
{
    double sum = 0;
    for (int i = 1; i + 1 < n; i++) {
        Point2 t[3] = { p[0], p[i], p[i + 1] };
        sum += polygon_area(t, 3);
    }
    return sum;
}

/* Reads the polygon in a tilted plane and sums the areas of what comes back. */
static double read_area(const Point2 *p, int n, uint32_t *n_triangles)
{
    static const double a[3] = { 0.6, -0.64, 0.48 }, b[3] = { 0.8, 0.48, -0.36 };      /* orthonormal */
    char *text = malloc(100 * (size_t)n + 100);
    int k = 0;
    for (int i = 0; i < n; i++)
        k += sprintf(text + k, "v %.9g %.9g %.9g\n", a[0] * p[i].x + b[0] * p[i].y, a[1] * p[i].x + b[1] * p[i].y, a[2] * p[i].x + b[2] * p[i].y);
    k += sprintf(text + k, "f");
    for (int i = 0; i < n; i++) k += sprintf(text + k, " %d", i + 1);
    Result r = read_obj(text);
    free(text);
    double sum = 0;
    for (uint32_t i = 0; r.ok && i < r.mesh.n_triangles; i++) {
        Vec3 c[3];
        for (int j = 0; j < 3; j++) c[j] = from_float(r.mesh.position[r.mesh.triangle[i][j]]);
        sum += length(cross(sub(c[1], c[0]), sub(c[2], c[0]))) / 2;
    }
    sum *= r.mesh.unit * r.mesh.unit;
    *n_triangles = r.mesh.n_triangles;
    mesh_free(&r.mesh);
    return sum;
}

static bool area_is_right(double area, const Point2 *p, int n)
{
    double expected = polygon_area(p, n);
    return fabs(area - expected) <= 2e-6 * expected + 1e-12;
}

enum { CORNERS = 50000 };
static Point2 corners[CORNERS];

static void check_polygon(int n, bool fan_fails)
{
    for (int turned = 0; turned < 2; turned++) {
        uint32_t n_triangles;
        double area = read_area(corners, n, &n_triangles);
        if (!CHECK(area_is_right(area, corners, n) && n_triangles <= (uint32_t)n - 2 && n_triangles > 0))
            printf("  %d corners, area %.9g, not %.9g, %u triangles\n", n, area, polygon_area(corners, n), (unsigned)n_triangles);
        if (fan_fails && !turned) CHECK(!area_is_right(fan_area(corners, n), corners, n));        /* the fault that the check must see */
        for (int i = 0; i < n / 2; i++) {
            Point2 swap = corners[i];
            corners[i] = corners[n - 1 - i];
            corners[n - 1 - i] = swap;
        }
    }
}

static void test_polygons(void)
{
    static const Point2 arrow[] = { { 0, 0 }, { 2, 1 }, { 0, 2 }, { 1, 1 } };
    static const Point2 square_and_middles[] = { { 0, 0 }, { 1, 0 }, { 2, 0 }, { 2, 1 }, { 2, 2 }, { 1, 2 }, { 0, 2 }, { 0, 1 } };
    static const Point2 frame[] = { { 0, 0 }, { 4, 0 }, { 4, 4 }, { 0, 4 }, { 0, 0 }, { 1, 1 }, { 1, 3 }, { 3, 3 }, { 3, 1 }, { 1, 1 } };
    static const Point2 horseshoe[] = { { 0, 0 }, { 5, 0 }, { 5, 5 }, { 4, 5 }, { 4, 1 }, { 1, 1 }, { 1, 5 }, { 0, 5 } };
    for (int start = 0; start < 4; start++) {
        for (int i = 0; i < 4; i++) corners[i] = arrow[(i + start) % 4];
        check_polygon(4, start % 2 == 0);
    }
    for (int start = 0; start < 8; start++) {
        for (int i = 0; i < 8; i++) corners[i] = square_and_middles[(i + start) % 8];
        check_polygon(8, false);
        for (int i = 0; i < 8; i++) corners[i] = horseshoe[(i + start) % 8];
        check_polygon(8, true);
    }
    memcpy(corners, frame, sizeof frame);
    check_polygon(10, true);

    Rng rng = rng_new(4, 0);
    for (int round = 0; round < 60; round++) {         /* star-shaped about the origin */
        int n = 5 + (int)below(&rng, round < 50 ? 40 : 3000);
        for (int i = 0; i < n; i++) {
            double angle = 2 * PI * (i + 0.9 * rng_double(&rng)) / n, radius = 0.1 + rng_double(&rng);
            corners[i] = (Point2){ radius * cos(angle), radius * sin(angle) };
        }
        check_polygon(n, n > 12);
    }
    int spiral = 2000;                                 /* there and back along a spiral */
    for (int i = 0; i < spiral; i++) {
        int k = i < spiral / 2 ? i : spiral - 1 - i;
        double angle = 0.05 * k, radius = 0.01 * angle + (i < spiral / 2 ? 0.05 : 0.06);
        corners[i] = (Point2){ radius * cos(angle), radius * sin(angle) };
    }
    check_polygon(spiral, true);
    for (int i = 0; i < CORNERS; i++) corners[i] = (Point2){ cos(2 * PI * i / CORNERS), sin(2 * PI * i / CORNERS) };
    check_polygon(CORNERS, false);
    for (int i = 0; i < CORNERS; i++) {                /* a gear */
        double radius = i % 4 < 2 ? 1 : 0.9;
        corners[i] = (Point2){ radius * cos(2 * PI * i / CORNERS), radius * sin(2 * PI * i / CORNERS) };
    }
    check_polygon(CORNERS, true);
    for (int i = 0; i < CORNERS - 2; i++) corners[i] = (Point2){ (double)i / CORNERS, i % 2 ? 1 : 0.001 * rng_double(&rng) };      /* a comb */
    corners[CORNERS - 2] = (Point2){ 1, -1 };
    corners[CORNERS - 1] = (Point2){ 0, -1 };
    check_polygon(CORNERS, true);

    /* crossing itself: some triangles, in bounded time */
    for (int round = 0; round < 20; round++) {
        int n = round == 0 ? CORNERS / 4 : 4 + (int)below(&rng, 500);
        uint32_t n_triangles;
        for (int i = 0; i < n; i++) corners[i] = (Point2){ rng_double(&rng), rng_double(&rng) };
        double area = read_area(corners, n, &n_triangles);
        CHECK(area > 0 && n_triangles > 0 && n_triangles <= (uint32_t)n - 2);
    }

    /* a bent quad folds along its shorter diagonal, whatever corner comes first */
    for (int start = 0; start < 4; start++) {
        char text[200];
        int k = sprintf(text, "v 0 0 0.5\nv 3 0 0\nv 3 1.2 0.5\nv 1 1 0\nf");
        for (int i = 0; i < 4; i++) k += sprintf(text + k, " %d", (start + i) % 4 + 1);
        Result r = read_obj(text);
        int with_first = 0;
        CHECK(r.ok && r.mesh.n_triangles == 2);
        for (uint32_t i = 0; r.ok && i < 6; i++) with_first += r.mesh.triangle[i / 3][i % 3] == 0;
        CHECK(with_first == 1);
        mesh_free(&r.mesh);
    }
}

/* Which side is the front, and what is kept. */

static double front_z(const Mesh *m, uint32_t i)
{
    Vec3 c[3];
    for (int j = 0; j < 3; j++) c[j] = from_float(m->position[m->triangle[i][j]]);
    return cross(sub(c[1], c[0]), sub(c[2], c[0])).z;
}

static void write_texture(const char *name, int r, int g, int b)
{
    char text[64];
    snprintf(text, sizeof text, "P3 1 1 255 %d %d %d\n", r, g, b);
    folder_write_text(name, text);
}

static void test_kept(void)
{
    Result r = read_obj(V4 "vn 0 0 -2\nvn 0 0 1\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2\nf 1//1 2//2 4\n");
    CHECK(r.ok && r.mesh.n_triangles == 3 && r.mesh.n_normals == 2);
    CHECK(front_z(&r.mesh, 0) < 0 && front_z(&r.mesh, 1) > 0 && front_z(&r.mesh, 2) > 0);
    CHECK(r.mesh.triangle_normal[2][0] == BVH_NONE && r.mesh.triangle_normal[0][0] == 0);
    CHECK((double)r.mesh.normal[0][2] == -1);
    mesh_free(&r.mesh);

    r = read_obj(V4 N1 "vn 1 0 0\nf 1 2 3\n");         /* nobody uses the normals */
    CHECK(r.ok && r.mesh.normal == NULL && r.mesh.triangle_normal == NULL && r.mesh.n_normals == 0);
    mesh_free(&r.mesh);
    r = read_obj(V4 N1 "vn 0 0 0\nf 1//1 2//1 3//2\n"); /* one corner has none */
    CHECK(r.ok && r.mesh.normal == NULL && r.mesh.triangle_normal == NULL);
    mesh_free(&r.mesh);
    r = read_obj(V4 "vn 1 0 0\nvn 0 3 4\nvn 0 0 1\nf 1//2 2//2 3//3\n");
    CHECK(r.ok && r.mesh.n_normals == 2 && r.mesh.triangle_normal[0][2] == 1);
    CHECK_NEAR((double)r.mesh.normal[0][1], 0.6, 1e-7);
    mesh_free(&r.mesh);

    r = read_obj("v 0 0 0\nv 3 0 0\nv 4 1 0\nv 1 1 0\nvn 0 0 1\nf 1 2 3 4\nf 1//1 2//1 3//1 4\nf 1//1 2//1 3//1\n");
    CHECK(r.ok && r.mesh.n_triangles == 5);            /* faces without normals before the first with some, and corners without */
    for (uint32_t i = 0; r.ok && i < 5; i++) CHECK((r.mesh.triangle_normal[i][0] == BVH_NONE) == (i < 4));
    mesh_free(&r.mesh);

    write_texture("t.ppm", 255, 255, 255);
    folder_write_text("m.mtl", "newmtl plain\nKd 0.1 0.2 0.3\nnewmtl unused\nmap_Kd nowhere.ppm\nnewmtl paper\nmap_Kd t.ppm\nnewmtl card\nmap_Kd t.ppm\n"
                        "newmtl lost\nKd 0.3 0.3 0.3\nmap_Kd nowhere.ppm\nnewmtl broken\nmap_Kd m.mtl\n");
    r = read_obj("mtllib m.mtl\n" V4 T4 "usemtl plain\nf 1/1 2/2 3/3\n");
    CHECK(r.ok && r.mesh.uv == NULL && r.mesh.triangle_uv == NULL && r.mesh.n_materials == 1 && r.mesh.n_textures == 0);
    CHECK(strcmp(r.mesh.material[0].name, "plain") == 0);
    mesh_free(&r.mesh);
    r = read_obj("mtllib m.mtl\nvt 9 9\n" V4 T4 "usemtl plain\nf 1/2 2/3 3/4\nusemtl paper\nf 1/-4 2/-3 3/-2\nf 1 2 4\nusemtl card\nf 2/-3 3/-2 4/-1\n"
                 "usemtl unused\nf 1 1 1\nusemtl none\n");
    CHECK(r.ok && r.mesh.n_triangles == 4 && r.mesh.n_materials == 3 && r.mesh.n_textures == 1 && r.mesh.n_uvs == 4);
    if (r.ok && r.mesh.triangle_uv) {
        CHECK(r.mesh.triangle_uv[0][0] == BVH_NONE && r.mesh.triangle_uv[2][0] == BVH_NONE);
        CHECK((double)r.mesh.uv[r.mesh.triangle_uv[1][1]][0] == 1);
        CHECK(r.mesh.material[1].map_kd && r.mesh.material[1].map_kd == r.mesh.material[2].map_kd);
    }
    CHECK(strstr(r.warnings, "without area") && r.warned == 1);
    mesh_free(&r.mesh);

    r = read_obj("mtllib m.mtl\n" V4 T4 "usemtl lost\nf 1/1 2/2 3/3\nusemtl broken\nf 1/1 3/3 4/4\n");
    CHECK(r.ok && r.mesh.n_materials == 2 && r.mesh.n_textures == 0 && r.mesh.uv == NULL && r.warned == 2);
    CHECK(strstr(r.warnings, "m.mtl:11: texture not found, Kd is used: 'nowhere.ppm'") && strstr(r.warnings, "m.mtl:13: texture cannot be read"));
    CHECK(r.mesh.material[0].kd.x == 0.3 && r.mesh.material[1].kd.x == 0.6);
    mesh_free(&r.mesh);

    r = read_obj(V4 FACE);                             /* no material */
    CHECK(r.ok && r.mesh.n_materials == 1 && r.mesh.material[0].kind == MATERIAL_DIFFUSE && r.mesh.material[0].kd.y == 0.5);
    CHECK(r.mesh.material[0].ks.x == 0 && r.mesh.material[0].ke.x == 0 && r.mesh.triangle_material[0] == 0);
    mesh_free(&r.mesh);

    r = read_obj(V4 "mtllib m.mtl\nusemtl x\nf 1 2 3\nusemtl plain\nf 1 3 4\nusemtl y\nf 1 2 4\nusemtl plain # again\nf 2 3 4\n");
    CHECK(r.ok && r.mesh.n_materials == 2);            /* unknown names share the grey */
    CHECK(r.mesh.triangle_material[0] == r.mesh.triangle_material[2] && r.mesh.triangle_material[1] == r.mesh.triangle_material[3]);
    mesh_free(&r.mesh);
    remove(folder_path("m.mtl"));
    remove(folder_path("t.ppm"));
}

/* Materials: an MTL text behind 'newmtl a', what becomes of it, and part of the warnings. */

static const struct { const char *text, *material, *words; } materials[] = {
    { "", "diffuse kd 0.6 0.6 0.6", NULL },
    { "Kd 0.5", "diffuse kd 0.5 0.5 0.5", NULL },
    { "Kd 0.5 0.25", "diffuse kd 0.5 0.25 0.25", NULL },
    { "Kd 0.5 0.25 0.125 # c", "diffuse kd 0.5 0.25 0.125", NULL },
    { "  kd 0.5\n\tKE 7 8 9", "diffuse kd 0.5 0.5 0.5 ke 7 8 9", NULL },
    { "Kd \\\n0.5 \\\r\n0.25 0.125", "diffuse kd 0.5 0.25 0.125", NULL },
    { "Kd 0.5\rKe 1\r\nNs 3\r", "diffuse kd 0.5 0.5 0.5 ke 1 1 1", NULL },
    { "Kd xyz 0.25 0.25 0.25", "diffuse kd 0.301196 0.237075 0.227211", NULL },
    { "Kd spectral f.rfl 2", "diffuse kd 0.6 0.6 0.6", "spectral" },
    { "Kd", "diffuse kd 0.6 0.6 0.6", "m.mtl:2: a statement without its value" },
    { "Kd -1 0.5 0.5", "diffuse kd 0 0.5 0.5", "m.mtl:2: a value is out of its range" },
    { "Kd nan 0.5 0.5", "diffuse kd 0 0.5 0.5", "m.mtl:2: not a number, taken as 0: 'nan'" },
    { "Kd 5 1 0.5", "diffuse kd 1 1 0.5", "m.mtl:1: materials that reflect more than all light are scaled down" },
    { "Kd 0.5\nKs 0.25\nNs 10", "diffuse kd 0.5 0.5 0.5 ks 0.25 0.25 0.25 ns 10", NULL },
    { "Kd 0.5\nKs 0.25\nNs 10\nillum 2", "diffuse kd 0.5 0.5 0.5 ks 0.25 0.25 0.25 ns 10", NULL },
    { "Kd 0.5\nKs 0.25\nNs 10\nillum 1", "diffuse kd 0.5 0.5 0.5", NULL },
    { "Kd 0.5\nKs 0.25\nNs 10\nillum 0", "diffuse kd 0.5 0.5 0.5", NULL },
    { "Kd 0.5\nillum 10", "diffuse kd 0.5 0.5 0.5", NULL },
    { "Kd 0.5\nKs 0.25\nillum 99", "diffuse kd 0.5 0.5 0.5 ks 0.25 0.25 0.25 ns 0", "m.mtl:4: unknown illum" },
    { "Kd 0.5\nillum x", "diffuse kd 0.5 0.5 0.5", "not a number" },
    { "Kd 0.75 0.5 0.25\nKs 0.75 0.25 0", "diffuse kd 0.5 0.5 0.25 ks 0.5 0.25 0 ns 0", "scaled down" },
    { "Ks 0.4\nNs -5", "diffuse kd 0.6 0.6 0.6 ks 0.4 0.4 0.4 ns 0", "m.mtl:3: a value is out" },
    { "Ks 0.4\nNs 1e7", "diffuse kd 0.6 0.6 0.6 ks 0.4 0.4 0.4 ns 1e+07", NULL },
    { "Ks 0.4\nNs 1e9", "diffuse kd 0.6 0.6 0.6 ks 0.4 0.4 0.4 ns 1e+08", "a value is out" },
    { "illum 3\nKs 0.5 0.6 0.7\nKd 1", "mirror ks 0.5 0.6 0.7", NULL },
    { "illum 5", "mirror ks 1 1 1", NULL },
    { "illum 8\nKs 2", "mirror ks 1 1 1", "scaled down" },
    { "illum 4\nNi 1.33", "glass ni 1.33 tf 1 1 1", NULL },
    { "illum 6\nNi 1\nTf 0.5 1 1", "glass ni 1 tf 0.5 1 1", NULL },
    { "illum 7\nNi 0\nKt 0.25", "glass ni 0.001 tf 0.25 0.25 0.25", "a value is out" },
    { "illum 9\nNi 100\nTf 2 2 2", "glass ni 10 tf 1 1 1", "a value is out" },
    { "illum 7\nd 0.1", "glass ni 1.5 tf 1 1 1", NULL },
    { "illum 7\nKe 3", "glass ni 1.5 tf 1 1 1 ke 3 3 3", NULL },
    { "d 1\nTr 0.5", "diffuse kd 0.6 0.6 0.6", NULL },
    { "d 0.5", "diffuse kd 0.6 0.6 0.6", "transparency" },
    { "d -halo 0.5", "diffuse kd 0.6 0.6 0.6", "transparency" },
    { "Tr 0.5", "diffuse kd 0.6 0.6 0.6", "transparency" },
    { "Tr 1", "diffuse kd 0.6 0.6 0.6", "Tr 1 without d" },
    { "Tr 0", "diffuse kd 0.6 0.6 0.6", NULL },
    { "d 1.5", "diffuse kd 0.6 0.6 0.6", "a value is out" },
    { "Tr -1", "diffuse kd 0.6 0.6 0.6", "a value is out" },
    { "sharpness 60\nKa 1 1 1\nmap_Ka t.ppm", "diffuse kd 0.6 0.6 0.6", NULL },
    { "Pr 0.5\nPm x\nPs\nPc 1\nPcr 1\naniso 0\nanisor 0\nnorm t.ppm\nmap_Pr t.ppm", "diffuse kd 0.6 0.6 0.6", "not supported and ignored: 'Pr'" },
    { "bump t.ppm\nmap_bump t.ppm\nmap_Bump -bm 2 t.ppm\nBump t.ppm", "diffuse kd 0.6 0.6 0.6", "'bump'" },
    { "disp a\ndecal a\nrefl -type sphere a\nmap_d a\nmap_Ns a\nmap_Tr a\nmap_opacity a\nmap_D a", "diffuse kd 0.6 0.6 0.6", "'map_opacity'" },
    { "foo 1\nfoo 2", "diffuse kd 0.6 0.6 0.6", "m.mtl:2: unknown statement 'foo' (2 times)" },
    { "newmtl\nKd 1", "diffuse kd 0.6 0.6 0.6", "m.mtl:2: newmtl without a name" },
    { "newmtl a\nKd 1", "diffuse kd 0.6 0.6 0.6", "m.mtl:2: material defined again" },
    { "NEWMTL b\nKd 1", "diffuse kd 0.6 0.6 0.6", NULL },
    { "Kd 0.1\n\0", "diffuse kd 0.1 0.1 0.1", NULL },
    { "map_Kd t.ppm", "diffuse map 1 0 0", NULL },
    { "map_Kd \"t.ppm\"  ", "diffuse map 1 0 0", NULL },
    { "map_kd my t.ppm", "diffuse map 0 1 0", NULL },
    { "map_Kd 3.ppm", "diffuse map 0 0 1", NULL },
    { "map_Kd sub\\s.ppm", "diffuse map 1 1 0", NULL },
    { "map_Kd C:\\Users\\me\\t.ppm", "diffuse map 1 0 0", NULL },
    { "map_Kd /nowhere/at all/t.ppm", "diffuse map 1 0 0", NULL },
    { "map_Kd t.ppm # c", "diffuse map 1 0 0", NULL },
    { "map_Kd -s 2 2 3.ppm", "diffuse map 0 0 1 at 2 2 0 0", NULL },
    { "map_Kd -s 3.ppm", "diffuse kd 0.6 0.6 0.6", "cannot be read: '-s'" },
    { "map_Kd -s 2 t.ppm", "diffuse map 1 0 0 at 2 1 0 0", NULL },
    { "map_Kd -o 0.5 -0.25 7 -s 1e1 .5 1 -clamp on t.ppm", "diffuse map 1 0 0 at 10 0.5 0.5 -0.25 clamp", NULL },
    { "map_Kd -clamp off -S 1 -3 t.ppm", "diffuse map 1 0 0 at 1 -3 0 0", NULL },
    { "map_Kd -clamp on t.ppm\nmap_Kd t.ppm", "diffuse map 1 0 0", NULL },
    { "map_Kd -s 1e300 t.ppm", "diffuse map 1 0 0 at 1e+30 1 0 0", "out of its range" },
    { "map_Kd -o 1 -s 1 1 1 -t 0 0 t.ppm", "diffuse map 1 0 0 at 1 1 1 0", "texture option without effect: '-t'" },
    { "map_Kd -mm 0 1 -bm 0.1 -clamp on -blendu off -blendv on -boost 2 -texres 5 -imfchan r -cc on -type sphere my t.ppm", "diffuse map 0 1 0 clamp",
      "'-imfchan'" },
    { "map_Kd -foo t.ppm", "diffuse map 1 0 0", "unknown texture option '-foo'" },
    { "map_Kd -foo 7 t.ppm", "diffuse map 1 0 0", "only part of the line" },
    { "map_Kd t.ppm -s 2 2 2", "diffuse map 1 0 0", "only part of the line" },
    { "map_Kd", "diffuse kd 0.6 0.6 0.6", "m.mtl:2: map_Kd without a file" },
    { "map_Kd -s 1 1 1", "diffuse kd 0.6 0.6 0.6", "without a file" },
    { "map_Kd sub", "diffuse kd 0.6 0.6 0.6", "m.mtl:2: texture not found" },
    { "map_Kd t.ppm\nKs 0.25 0.25 0.25\nNs 5", "diffuse map 0.8 0 0 ks 0.2 0.25 0.25 ns 5", "scaled down" },
};

/* Where a texture lies, if not everywhere as it is. */
static int place(const MapPlace *p, char *text)
{
    int n = 0;
    if (p->scale[0] != 1 || p->scale[1] != 1 || p->offset[0] != 0 || p->offset[1] != 0)
        n = sprintf(text, " at %g %g %g %g", p->scale[0], p->scale[1], p->offset[0], p->offset[1]);
    return n + sprintf(text + n, p->clamp ? " clamp" : "");
}

static void describe(const Material *m, char *text)
{
    if (m->kind == MATERIAL_MIRROR) text += sprintf(text, "mirror ks %g %g %g", m->ks.x, m->ks.y, m->ks.z);
    else if (m->kind == MATERIAL_GLASS) text += sprintf(text, "glass ni %g tf %g %g %g", m->ni, m->tf.x, m->tf.y, m->tf.z);
    else {
        if (m->map_kd) text += sprintf(text, "diffuse map %g %g %g", (double)m->map_kd->rgb[0], (double)m->map_kd->rgb[1], (double)m->map_kd->rgb[2]);
        if (m->map_kd) text += place(&m->map_place, text);
        else text += sprintf(text, "diffuse kd %g %g %g", m->kd.x, m->kd.y, m->kd.z);
        if (max3(m->ks) > 0) text += sprintf(text, " ks %g %g %g ns %g", m->ks.x, m->ks.y, m->ks.z, m->ns);
    }
    if (max3(m->ke) > 0) sprintf(text, " ke %g %g %g", m->ke.x, m->ke.y, m->ke.z);
}

static void test_materials(void)
{
    write_texture("t.ppm", 255, 0, 0);
    write_texture("my t.ppm", 0, 255, 0);
    write_texture("3.ppm", 0, 0, 255);
    write_texture("sub/s.ppm", 255, 255, 0);
    char text[1000], description[200];
    for (size_t i = 0; i < sizeof materials / sizeof materials[0]; i++) {
        snprintf(text, sizeof text, "newmtl a\n%s", materials[i].text);
        folder_write_text("m.mtl", text);
        Result r = read_obj("mtllib m.mtl\n" V4 T4 "usemtl a\nf 1/1 2/2 3/3\n");
        description[0] = 0;
        if (r.ok) describe(&r.mesh.material[0], description);
        if (!CHECK(r.ok && strcmp(description, materials[i].material) == 0
                   && (materials[i].words ? strstr(r.warnings, materials[i].words) != NULL : r.warned == 0)))
            printf("  %s\n  is %s\n  not %s\n  %s%s\n", materials[i].text, description, materials[i].material, r.error, r.warnings);
        for (uint32_t k = 0; r.ok && k < r.mesh.n_materials; k++) CHECK(max3(add(r.mesh.material[k].kd, r.mesh.material[k].ks)) <= 1 + 1e-12);
        mesh_free(&r.mesh);
    }

    /* one picture, scaled for the glossy material only */
    folder_write_text("m.mtl", "newmtl a\nmap_Kd t.ppm\nnewmtl b\nmap_Kd ./t.ppm\nKs 1 1 1\nNs 5\nnewmtl c\nmap_Kd t.ppm\nKs 1 1 1\nNs 5\n");
    Result r = read_obj("mtllib m.mtl\n" V4 T4 "usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 2/2 4/3\nusemtl c\nf 1/1 2/2 4/3\n");
    CHECK(r.ok && r.mesh.n_materials == 3);
    CHECK((double)r.mesh.material[0].map_kd->rgb[0] == 1 && (double)r.mesh.material[1].map_kd->rgb[0] == 0.5);
    CHECK((double)r.mesh.material[2].map_kd->rgb[0] == 0.5 && r.mesh.material[2].map_kd != r.mesh.material[0].map_kd);
    mesh_free(&r.mesh);

    /* files as a whole */
    static const struct { const char *text; size_t n; const char *words; } whole[] = {
        { BYTES(""), "m.mtl: no new material" },
        { BYTES("Kd 1 1 1\nKs 1\n"), "m.mtl:1: statements that belong to no material (2 times)" },
        { BYTES("newmtl a\nKd 1\n\0\1\2"), "m.mtl:3: binary data" },
        { BYTES("\xff\xfen\0"), "m.mtl: cannot be read: 'UTF-16" },
        { BYTES("\xef\xbb\xbfnewmtl a\rKd 0.5"), NULL },
        { BYTES("newmtl a\r\nKd 0.5\r\n"), NULL },
    };
    for (size_t i = 0; i < sizeof whole / sizeof whole[0]; i++) {
        folder_write("m.mtl", whole[i].text, whole[i].n);
        r = read_obj("mtllib m.mtl\n" V4 FACE);
        CHECK(r.ok);
        if (!CHECK(whole[i].words ? strstr(r.warnings, whole[i].words) != NULL : r.warned == 0)) printf("  %zu: %s\n", i, r.warnings);
        mesh_free(&r.mesh);
    }
    remove(folder_path("m.mtl"));
    remove(folder_path("t.ppm"));
    remove(folder_path("my t.ppm"));
    remove(folder_path("3.ppm"));
    remove(folder_path("sub/s.ppm"));
}

/* SCENE.cam. */

static void test_camera(void)
{
    CameraSettings c = { 0 };
    Report report = { 0 };
    CHECK(cam_read(&c, folder_path("none.cam"), &report) && !c.has_eye && !report.error[0]);
    folder_write_text("a.cam", "# camera\n\neye 278 273 -800\r\nlook 278 273 0 # c\n\tup 0 1 0\nfov 39.3\nsize 512 256\naperture 0\nfocus 1e3");
    CHECK(cam_read(&c, folder_path("a.cam"), &report));
    CHECK(c.has_eye && c.has_look && c.has_up && c.has_fov && c.has_size && c.has_aperture && c.has_focus);
    CHECK(c.eye.z == -800 && c.look.x == 278 && c.up.y == 1 && c.fov == 39.3 && c.width == 512 && c.height == 256 && c.aperture == 0 && c.focus == 1000);
    CHECK(!cam_read(&c, folder_path("sub"), &report));
    static const struct { const char *text, *words; } wrong[] = {
        { "eye 1 2", ":1: 3 numbers expected, 2 found" },
        { "\neye 1 2 3 4", ":2: '4' is more than" },
        { "eye 1 2 nan", "'nan' is not a number" },
        { "eye 1 2 1e999", "'1e999' is too large" },
        { "eye 1,5 2 3", "'1,5' has a decimal comma" },
        { "up 0 0 0", "up must not be" },
        { "fov 0", "fov must lie" },
        { "fov 180", "fov must lie" },
        { "fov", "1 number expected" },
        { "size 0 5", "size must be" },
        { "size 5 65536", "size must be" },
        { "size 5.5 5", "size must be" },
        { "size 512x512", "'512x512'" },
        { "aperture -1", "aperture must not" },
        { "focus 0", "focus must be" },
        { "zoom 3", ":1: unknown keyword 'zoom'" },
        { "\xff\xfe", "UTF-16" },
    };
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        CameraSettings untouched = { 0 };
        folder_write_text("a.cam", wrong[i].text);
        CHECK(!cam_read(&untouched, folder_path("a.cam"), &report) && !untouched.has_eye);
        if (!CHECK(strstr(report.error, wrong[i].words) && strstr(report.error, "a.cam"))) printf("  %s: %s\n", wrong[i].text, report.error);
    }
}

/* The room that waits for the rest of a file is given back where address space is short: three vertices and a million faces before so long a comment that
 * more vertices might come in its place than there is room for beside the faces. (Skipped where the address space is unknown, or a sanitizer's.) */
static void test_short_of_memory(void)
{
    enum { FACES = 1000000, COMMENTS = 5500, LENGTH = 4000, MEGABYTE = 1 << 20 };
    unsigned long pages = 0;
    struct rlimit before, limit;
    FILE *f = fopen("/proc/self/statm", "r");
    if (f && fscanf(f, "%lu", &pages) != 1) pages = 0;
    if (f) fclose(f);
    uint64_t used = pages * (uint64_t)sysconf(_SC_PAGESIZE);
    if (used == 0 || used > (uint64_t)1 << 36 || getrlimit(RLIMIT_AS, &before) != 0) return;
    f = fopen(folder_path("a.obj"), "wb");
    fputs("v 0 0 0\nv 1 0 0\nv 0 1 0\n", f);
    for (int i = 0; i < FACES; i++) fputs("f 1 2 3\n", f);
    for (int i = 0; i < COMMENTS; i++) fprintf(f, "#%*d\n", LENGTH, i);
    fclose(f);
    limit = before;
    limit.rlim_cur = (rlim_t)(used + 56 * (uint64_t)MEGABYTE);
    CHECK(setrlimit(RLIMIT_AS, &limit) == 0);
    Result r = read_file("a.obj");
    CHECK(setrlimit(RLIMIT_AS, &before) == 0);
    if (!CHECK(r.ok)) printf("%s\n", r.error);
    CHECK(r.mesh.n_triangles == FACES);
    mesh_free(&r.mesh);
}

int main(void)
{
    if (mkdir(folder_path("sub"), 0777) != 0) {
        perror(folder_path("sub"));
        return 2;
    }
    test_rows();
    test_files();
    test_digits();
    test_numbers();
    test_quick();
    test_scale();
    test_polygons();
    test_kept();
    test_materials();
    test_camera();
    test_short_of_memory();
    CHECK(folder_entries(folder(), false) == 4 && folder_remove());        /* a.obj, a.cam, sub, warnings: nothing that a reader has left */
    return check_report();
}
