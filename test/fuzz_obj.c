/* Feeds arbitrary bytes to the readers of OBJ, MTL and SCENE.cam: the first byte picks one (modulo 3), the rest is the file. As a libFuzzer target:
 *     clang -g -O1 -DFUZZ_LIBFUZZER -fsanitize=fuzzer,address,undefined test/fuzz_obj.c obj.c mtl.c text.c polygon.c mesh.c image.c texture.c output.c cache.c -lm
 *     ./a.out -max_len=4096 corpus-to-grow test/corpus/obj
 * Without FUZZ_LIBFUZZER a program that runs the files given to it. */
#include "../obj.h"
#include "folder.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n);

/* What the rest of the program relies on. */
static void check_mesh(const Mesh *m)
{
    if (m->n_triangles == 0 || m->n_materials == 0 || !finite3(m->centre) || !(m->unit > 0) || !isfinite(m->unit)) abort();
    for (uint32_t i = 0; i < m->n_positions; i++)
        for (int k = 0; k < 3; k++)
            if (!(fabsf(m->position[i][k]) <= 1)) abort();
    for (uint32_t i = 0; i < m->n_triangles; i++) {
        if (m->triangle_material[i] >= m->n_materials) abort();
        for (int k = 0; k < 3; k++) {
            if (m->triangle[i][k] >= m->n_positions) abort();
            if (m->triangle_normal && m->triangle_normal[i][0] != BVH_NONE && m->triangle_normal[i][k] >= m->n_normals) abort();
            if (m->triangle_uv && m->triangle_uv[i][0] != BVH_NONE && m->triangle_uv[i][k] >= m->n_uvs) abort();
        }
    }
    for (uint32_t i = 0; i < m->n_normals; i++)
        if (!(fabs(length(from_float(m->normal[i])) - 1) < 1e-6)) abort();
    for (uint32_t i = 0; i < m->n_uvs; i++)
        if (!isfinite(m->uv[i][0]) || !isfinite(m->uv[i][1])) abort();
    for (uint32_t i = 0; i < m->n_materials; i++) {
        const Material *a = &m->material[i];
        Rgb sum = add(a->kd, a->ks);
        if (!finite3(a->ke) || !(max3(sum) <= 1 + 1e-12) || !(max3(a->tf) <= 1) || !(a->ns >= 0 && a->ns <= 1e8) || !(a->ni > 0)) abort();
        if (!(fmin(sum.x, fmin(sum.y, sum.z)) >= 0)) abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    if (n == 0) return 0;
    static const char use[] = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1 2 3\n";
    Report report = { 0 };
    Mesh mesh;
    CameraSettings camera = { 0 };
    switch (data[0] % 3) {
    case 0:
        folder_write("a.obj", data + 1, n - 1);
        if (obj_read(&mesh, folder_path("a.obj"), &report)) check_mesh(&mesh);
        else if (!report.error[0]) abort();
        mesh_free(&mesh);
        break;
    case 1:
        folder_write_text("a.obj", use);
        folder_write("a.mtl", data + 1, n - 1);
        if (!obj_read(&mesh, folder_path("a.obj"), &report)) abort();
        check_mesh(&mesh);
        mesh_free(&mesh);
        break;
    default:
        folder_write("a.cam", data + 1, n - 1);
        if (!cam_read(&camera, folder_path("a.cam"), &report) && !report.error[0]) abort();
        if (camera.has_fov && !(camera.fov > 0 && camera.fov < 180)) abort();
        if (camera.has_size && (camera.width == 0 || camera.height == 0)) abort();
    }
    folder_entries(folder(), true);    /* the next input finds nothing of this one */
    return 0;
}

#ifndef FUZZ_LIBFUZZER
int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        FILE *f = fopen(argv[i], "rb");
        static uint8_t data[1 << 20];
        if (!f) {
            perror(argv[i]);
            return 1;
        }
        size_t n = fread(data, 1, sizeof data, f);
        fclose(f);
        LLVMFuzzerTestOneInput(data, n);
    }
    printf("%d inputs passed\n", argc - 1);
    return 0;
}
#endif
