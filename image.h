/* Pictures: float RGB in memory; PFM, PPM and PNG files written, PFM, PPM, PGM, PNG and TGA files read; the error of one against another.
 *
 * Knows nothing of scenes or paths. Rows run from top to bottom in memory, whatever the file's order. Values are linear light. */
#ifndef IMAGE_H
#define IMAGE_H
#include "report.h"
#include "vec.h"
#include <stdint.h>

typedef struct {
    uint32_t width, height;
    float *rgb;                /* [height][width][3] */
} Image;

/* A black picture; NULL if memory runs out. */
Image *image_new(uint32_t width, uint32_t height);
void image_free(Image *image);

/* True if image_write can tell the format from the name's ending: .pfm, .ppm, .png (case-insensitive). */
bool image_format_known(const char *path);

/* Writes PFM (linear, little endian, scale -1, rows bottom to top), or PPM/PNG (8 bit sRGB of clamp(rgb 2^exposure_ev, 0, 1)).
 * The file appears whole or not at all: it is written under a temporary name in the same folder and renamed. False with an error otherwise. */
bool image_write(const Image *image, const char *path, double exposure_ev, Report *report);

/* Reads a picture by its content, not by its name. 8-bit formats are decoded from sRGB, 16-bit PNG too; PFM is taken as it is.
 * NULL with an error 'FILE: what is wrong'. */
Image *image_read(const char *path, Report *report);

/* The same from the n bytes of a file, name being what errors call it. */
Image *image_decode(const unsigned char *data, size_t n, const char *name, Report *report);

typedef struct {
    double rmse;               /* sqrt of the mean over pixels and channels of (a-b)^2 */
    double relmse;             /* mean over pixels and channels of (a-b)^2 / (b^2 + 0.01 m^2), m the mean of b over pixels and channels */
    double ratio_of_means;     /* mean(a) / mean(b) */
} ImageError;

/* The error of a against the reference b, of equal size. */
ImageError image_compare(const Image *a, const Image *b);
#endif
