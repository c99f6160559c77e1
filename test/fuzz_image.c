/* Feeds arbitrary bytes to the readers of pictures. As a libFuzzer target:
 *     clang -g -O1 -DFUZZ_LIBFUZZER -fsanitize=fuzzer,address,undefined test/fuzz_image.c image.c texture.c output.c -lm
 *     ./a.out -max_len=4096 corpus-to-grow test/corpus/image
 * Without FUZZ_LIBFUZZER a program that runs the files given to it, to look at a crash or to run the corpus as a test. */
#include "../image.h"
#include "../png.h"
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n);

static void decode(const unsigned char *data, size_t n)
{
    Report report = { .warnings = NULL };
    Image *image = image_decode(data, n, "name", &report);
    if (!image) {
        if (strncmp(report.error, "name: ", 6) != 0) abort();
        return;
    }
    /* Every pixel is there; only PFM can hold what is not in 0..1. */
    bool any = data[0] == 'P' && (data[1] == 'F' || data[1] == 'f');
    for (size_t i = 0; i < (size_t)image->width * image->height * 3; i++)
        if (!any && !(image->rgb[i] >= 0 && image->rgb[i] <= 1)) abort();
    image_free(image);
}

static void put_u32(unsigned char *at, uint32_t value)
{
    for (unsigned k = 0; k < 4; k++) at[k] = (unsigned char)(value >> (24 - 8 * k));
}

/* Returns the size of the chunk. */
static size_t put_chunk(unsigned char *at, const char *type, const unsigned char *data, size_t n)
{
    put_u32(at, (uint32_t)n);
    memcpy(at + 4, type, 4);
    memcpy(at + 8, data, n);
    put_u32(at + 8 + n, png_crc(0, at + 4, n + 4));
    return n + 12;
}

/* Checksums keep mutated PNG files from going far: the same file with each chunk's made right ... */
static void decode_repaired(const unsigned char *data, size_t n)
{
    unsigned char *copy = malloc(n);
    if (!copy) return;
    memcpy(copy, data, n);
    for (size_t at = 8; n - at >= 12;) {
        size_t length = (size_t)copy[at] << 24 | (size_t)copy[at + 1] << 16 | (size_t)copy[at + 2] << 8 | copy[at + 3];
        if (length > n - at - 12) break;
        put_u32(copy + at + 8 + length, png_crc(0, copy + at + 4, length + 4));
        at += length + 12;
    }
    decode(copy, n);
    free(copy);
}

/* ... and a PNG file of these rows, in one stored block with the right checksum: width, height, depth, type, interlace from the first five
 * bytes, the palette from the next six. */
static void decode_rows(const unsigned char *data, size_t n)
{
    unsigned char *file = malloc(n + 200), *zlib = malloc(n + 11), header[13] = { 0 };
    size_t rows = n - 11, at = 8;
    if (file && zlib) {
        header[3] = data[0];
        header[7] = data[1];
        header[8] = data[2];
        header[9] = data[3];
        header[12] = data[4] & 1;
        memcpy(file, "\x89PNG\r\n\x1a\n", 8);
        at += put_chunk(file + at, "IHDR", header, sizeof header);
        at += put_chunk(file + at, "PLTE", data + 5, 6);
        memcpy(zlib, "\x78\x01\x01", 3);
        zlib[3] = (unsigned char)rows;
        zlib[4] = (unsigned char)(rows >> 8);
        zlib[5] = (unsigned char)~rows;
        zlib[6] = (unsigned char)(~rows >> 8);
        memcpy(zlib + 7, data + 11, rows);
        put_u32(zlib + 7 + rows, png_adler(data + 11, rows));
        at += put_chunk(file + at, "IDAT", zlib, rows + 11);
        at += put_chunk(file + at, "IEND", header, 0);
        decode(file, at);
    }
    free(zlib);
    free(file);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n)
{
    decode(data, n);
    if (n >= 8 && memcmp(data, "\x89PNG\r\n\x1a\n", 8) == 0) decode_repaired(data, n);
    else if (n > 11 && n < 65535) decode_rows(data, n);
    return 0;
}

#ifndef FUZZ_LIBFUZZER
int main(int argc, char **argv)
{
    enum { SIZE_MAX_READ = 1 << 24 };
    for (int i = 1; i < argc; i++) {
        FILE *file = fopen(argv[i], "rb");
        if (!file) {
            perror(argv[i]);
            return 1;
        }
        unsigned char *data = malloc(SIZE_MAX_READ);
        size_t n = data ? fread(data, 1, SIZE_MAX_READ, file) : 0;
        fclose(file);
        unsigned char *exact = data ? realloc(data, n + !n) : NULL;     /* so that a byte read too many is seen */
        if (!exact) return 1;
        LLVMFuzzerTestOneInput(exact, n);
        free(exact);
    }
    printf("%d files read\n", argc - 1);
    return 0;
}
#endif
