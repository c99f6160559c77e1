/* Materials of MTL files, by name, as the renderer wants them. Knows nothing of meshes. */
#ifndef MTL_H
#define MTL_H
#include "text.h"

/* What an MTL file says of one material; a number that is not given is NAN. */
typedef struct {
    uint32_t file;
    unsigned long line, map_line;
    Rgb kd, ks, tf, ke;
    double ns, ni, d, tr;
    int illum;                         /* -1 = not given */
    char *map_kd;                      /* path of the texture or, if that was not found, the name as written; NULL if there is none */
    bool map_found;
    MapPlace map_place;
} MtlEntry;

/* A picture, scaled so that what it reflects and Ks do not add up to more than 1. */
typedef struct {
    char *path;
    Rgb factor;
    Rgb largest;                       /* of each channel, before scaling */
    Image *image;                      /* NULL if it could not be read */
    bool used;
} MtlTexture;

typedef struct {
    Names files, names;                /* MTL files read; materials, numbered as entry is */
    MtlEntry *entry;
    MtlTexture *texture;
    uint32_t entry_capacity, n_textures, texture_capacity;
} MtlLibrary;

/* Adds the materials of a file; the first definition of a name counts. What is wrong with the file is noted. False only if memory runs out. */
bool mtl_read(MtlLibrary *library, const char *path, Notes *notes);

/* The material with the number that names_find gave; reads its texture unless another material had it read. Points into the library's textures
 * until mtl_textures hands them over. False only if memory runs out. */
bool mtl_material(MtlLibrary *library, uint32_t number, Material *material, Notes *notes, Report *report);

/* A face without a material is Lambert 0.5 grey. False if memory runs out. */
bool mtl_default(Material *material);

/* Hands over the textures in use; the array and the pictures are the caller's. False if memory runs out. */
bool mtl_textures(MtlLibrary *library, Image ***texture, uint32_t *n);

void mtl_free(MtlLibrary *library);
#endif
