/* Text files: see text.h. The conversion of numbers is exact in every case: what one division of doubles cannot do (Clinger, How to Read
 * Floating Point Numbers Accurately) is done by integer division with remainder, in 128 bits where they suffice, else in as many as needed. */
#include "text.h"
#include "cache.h"
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Blocks of lines. */

enum { BLOCK_SIZE = 1 << 18 };         /* stays in the second-level cache */

bool text_open(Text *t, const char *path, int *error_number)
{
    *t = (Text){ .path = path, .line = 1, .size = BLOCK_SIZE };
    struct stat status;
    t->fd = open(path, O_RDONLY);
    if (t->fd >= 0 && fstat(t->fd, &status) == 0) {
        if (S_ISDIR(status.st_mode)) errno = EISDIR;
        else {
            char *memory = calloc(TEXT_MARGIN + t->size + TEXT_PADDING, 1);
            if (memory) {
                t->left = status.st_size > 0 ? (uint64_t)status.st_size : 0;
                t->p = t->end = t->buffer = memory + TEXT_MARGIN;
                return true;
            }
            errno = ENOMEM;
        }
    }
    *error_number = errno;
    t->error = strerror(errno);
    if (t->fd >= 0) close(t->fd);
    return false;
}

void text_close(Text *t)
{
    free(t->buffer - TEXT_MARGIN);
    close(t->fd);
}

static bool fail(Text *t, const char *error)
{
    t->error = error;
    t->p = t->end;
    return false;
}

/* One past the last line end with no backslash before it, or NULL. A \r at the very end may be half of a \r\n and does not count. */
static char *last_break(Text *t)
{
    char *p = t->buffer + t->filled - (t->buffer[t->filled - 1] == '\r');
    while (p > t->buffer) {
        char *after = p--;
        if (!is_line_end(*p)) continue;
        char *q = p - (p > t->buffer && p[0] == '\n' && p[-1] == '\r');
        while (q > t->buffer && is_blank(q[-1])) q--;
        if (q == t->buffer || q[-1] != '\\') return after;
    }
    return NULL;
}

bool text_more(Text *t)
{
    size_t tail = (size_t)(t->buffer + t->filled - t->end);
    memmove(t->buffer, t->end, tail);
    t->filled = tail;
    t->p = t->end = t->buffer;
    for (;;) {
        while (!t->at_end && t->filled < t->size) {
            ssize_t n = read(t->fd, t->buffer + t->filled, t->size - t->filled);
            if (n > 0) {
                t->filled += (size_t)n;
                t->left -= (uint64_t)n < t->left ? (uint64_t)n : t->left;
            } else if (n == 0) t->at_end = true;
            else if (errno != EINTR) return fail(t, strerror(errno));
        }
        if (!t->started) {
            t->started = true;
            if (t->filled >= 2 && (memcmp(t->buffer, "\xff\xfe", 2) == 0 || memcmp(t->buffer, "\xfe\xff", 2) == 0))
                return fail(t, "UTF-16 text is not supported, save the file as UTF-8");
            if (t->filled >= 3 && memcmp(t->buffer, "\xef\xbb\xbf", 3) == 0) memset(t->buffer, ' ', 3);
        }
        if (t->at_end) {
            if (t->filled > 0 && t->buffer[t->filled - 1] == '\x1a') t->filled--;              /* the end mark of CP/M and DOS */
            if (t->filled == 0) return false;
            if (!is_line_end(t->buffer[t->filled - 1])) t->buffer[t->filled++] = '\n';         /* fits: TEXT_PADDING */
            t->end = t->buffer + t->filled;
            return true;
        }
        char *after = last_break(t);
        if (after) {
            t->end = after;
            return true;
        }
        if (t->size > SIZE_MAX / 4) return fail(t, "a line is too long");
        char *memory = realloc(t->buffer - TEXT_MARGIN, TEXT_MARGIN + 2 * t->size + TEXT_PADDING);
        if (!memory) return fail(t, "a line is too long for the memory");
        t->p = t->end = t->buffer = memory + TEXT_MARGIN;
        memset(t->buffer + t->size, 0, t->size + TEXT_PADDING);
        t->size *= 2;
    }
}

bool text_join(Text *t, char *start)
{
    bool joined = false;
    for (;;) {
        char *p = start;
        while (!is_stop(*p)) p++;
        char *q = p, *next = p + (p[0] == '\r' && p[1] == '\n') + 1;
        while (q > start && is_blank(q[-1])) q--;
        if (*p == '#' || q == start || q[-1] != '\\') return joined;
        joined = true;
        q[-1] = ' ';
        if (next >= t->end) return true;       /* nothing comes after: this line end stays */
        memset(p, ' ', (size_t)(next - p));
        t->joined++;
        start = next;
    }
}

/* Numbers. */

/* m 2^exponent rounded to nearest, ties to even; the top bit of m is set, 'more' says that the true value is a little above. */
static double assemble(uint64_t m, bool more, int exponent)
{
    int drop = 11, least = -1074 - exponent;   /* the last bit of a double is worth 2^-1074 or more */
    if (least > drop) drop = least;
    if (drop > 64) return 0;
    uint64_t kept = drop < 64 ? m >> drop : 0, rest = m << (64 - drop), half = (uint64_t)1 << 63;
    if (rest > half || (rest == half && (more || (kept & 1)))) kept++;
    return ldexp((double)kept, exponent + drop);
}

/* (high 2^64 + low) / d for high < d, d with its top bit set: two steps of long division by halves [Knuth, The Art of Computer Programming 2, 4.3.1]. */
static uint64_t divide_128(uint64_t high, uint64_t low, uint64_t d, uint64_t *remainder)
{
    uint64_t quotient = 0, d1 = d >> 32, d0 = d & 0xffffffffu;
    for (int step = 0; step < 2; step++) {
        uint64_t next = step == 0 ? low >> 32 : low & 0xffffffffu;
        uint64_t q = high / d1, r = high % d1;
        while (q >> 32 || q * d0 > (r << 32 | next)) {
            q--;
            r += d1;
            if (r >> 32) break;
        }
        high = (high << 32 | next) - q * d;    /* modulo 2^64, as the true value is below d */
        quotient = quotient << 32 | q;
    }
    *remainder = high;
    return quotient;
}

/* Natural numbers of up to LIMBS 32-bit digits, the lowest first. */
enum { LIMBS = 160, DIGITS_KEPT = 800, DECADES = 400 };
typedef struct { uint32_t limb[LIMBS]; int n; } Big;

static void big_multiply_add(Big *a, uint32_t factor, uint32_t addend)
{
    uint64_t carry = addend;
    for (int i = 0; i < a->n; i++) {
        carry += (uint64_t)a->limb[i] * factor;
        a->limb[i] = (uint32_t)carry;
        carry >>= 32;
    }
    if (carry) a->limb[a->n++] = (uint32_t)carry;
}

static void big_power_of_ten(Big *a, int exponent)
{
    for (; exponent > 0; exponent -= 8) big_multiply_add(a, POWER_OF_TEN_32[exponent < 8 ? exponent : 8], 0);
}

static int big_bits(const Big *a)
{
    int bits = 32 * (a->n - 1);
    for (uint32_t top = a->limb[a->n - 1]; top; top >>= 1) bits++;
    return bits;
}

static void big_shift_left(Big *a, int bits)
{
    int limbs = bits / 32;
    big_multiply_add(a, (uint32_t)1 << bits % 32, 0);
    if (limbs == 0) return;
    memmove(a->limb + limbs, a->limb, (size_t)a->n * sizeof a->limb[0]);
    memset(a->limb, 0, (size_t)limbs * sizeof a->limb[0]);
    a->n += limbs;
}

static bool big_less(const Big *a, const Big *b)
{
    if (a->n != b->n) return a->n < b->n;
    for (int i = a->n - 1; i >= 0; i--)
        if (a->limb[i] != b->limb[i]) return a->limb[i] < b->limb[i];
    return false;
}

static void big_subtract(Big *a, const Big *b)
{
    uint64_t borrow = 0;
    for (int i = 0; i < a->n; i++) {
        uint64_t d = (uint64_t)a->limb[i] - (i < b->n ? b->limb[i] : 0) - borrow;
        a->limb[i] = (uint32_t)d;
        borrow = d >> 63;
    }
    while (a->n > 0 && a->limb[a->n - 1] == 0) a->n--;
}

/* a * 10^exponent for a > 0. The bounds of LIMBS: a < 10^801 and -DECADES - 801 <= exponent, a 10^exponent < 10^DECADES. */
static double big_round(Big *a, int exponent)
{
    Big b = { .limb = { 1 }, .n = 1 };
    if (exponent >= 0) big_power_of_ten(a, exponent);
    else big_power_of_ten(&b, -exponent);
    int shift = big_bits(a) - big_bits(&b);
    if (shift > 0) big_shift_left(&b, shift);
    else big_shift_left(a, -shift);
    if (big_less(a, &b)) {
        big_multiply_add(a, 2, 0);
        shift--;
    }
    uint64_t quotient = 0;             /* of a/b, which lies in [1,2) */
    for (int bit = 0; bit < 64; bit++) {
        quotient <<= 1;
        if (!big_less(a, &b)) {
            big_subtract(a, &b);
            quotient |= 1;
        }
        big_multiply_add(a, 2, 0);
    }
    return assemble(quotient, a->n > 0, shift - 63);
}

double number_round(uint64_t digits, int exponent)
{
    if (digits == 0) return 0;
    if (FLT_EVAL_METHOD == 0 && digits >> 53 == 0 && exponent >= -22 && exponent <= 22) {
        double d = (double)(int64_t)digits;
        return exponent < 0 ? d / POWER_OF_TEN[-exponent] : d * POWER_OF_TEN[exponent];
    }
    if (exponent < 0 && exponent >= -19) {
        uint64_t d = 1, a = digits, remainder;
        int e = 0;
        for (int i = exponent; i < 0; i++) d *= 10;
        while (!(d >> 63)) d <<= 1, e++;
        while (!(a >> 63)) a <<= 1, e--;
        uint64_t quotient = a >= d ? divide_128(a >> 1, a << 63, d, &remainder) : divide_128(a, 0, d, &remainder);
        return assemble(quotient, remainder != 0, e - (a >= d ? 63 : 64));
    }
    if (exponent > DECADES) return HUGE_VAL;
    if (exponent < -DECADES) return 0;
    Big big = { .limb = { (uint32_t)digits, (uint32_t)(digits >> 32) }, .n = digits >> 32 ? 2 : 1 };
    return big_round(&big, exponent);
}

/* The number at p, infinite if too large; NULL if there is none. */
static const char *read_number(const char *p, double *value)
{
    bool negative = *p == '-';
    p += negative || *p == '+';
    const char *first = NULL;          /* the first digit that is not 0 */
    int64_t significant = 0, exponent = 0;
    uint64_t digits = 0;               /* right up to 19 of them */
    bool any = false, point = false;
    const char *q = p;
    for (;; q++) {
        if (*q == '.' && !point) {
            point = true;
            continue;
        }
        if (*q < '0' || *q > '9') break;
        any = true;
        exponent -= point;
        if (!first && *q == '0') continue;
        if (!first) first = q;
        if (++significant <= 19) digits = digits * 10 + (uint64_t)(*q - '0');
    }
    if (!any) return NULL;
    if ((*q | 32) == 'e') {
        int64_t written;
        q = integer_scan((char *)q + 1, &written);
        if (!q) return NULL;
        exponent += written;
    }
    int64_t magnitude = significant + exponent;       /* |value| < 10^magnitude */
    double v;
    if (!first || magnitude < -DECADES) v = 0;
    else if (magnitude > DECADES) v = HUGE_VAL;
    else if (significant <= 19) v = number_round(digits, (int)exponent);
    else {
        Big big = { .n = 0 };
        int64_t kept = 0;
        bool more = false;
        for (const char *d = first; kept < significant && kept < DIGITS_KEPT; d++) {
            if (*d == '.') continue;
            big_multiply_add(&big, 10, (uint32_t)(*d - '0'));
            kept++;
            if (kept == DIGITS_KEPT) for (d++; (*d >= '0' && *d <= '9') || *d == '.'; d++) more |= *d > '0';
        }
        exponent += significant - kept;
        if (more) {                    /* what is cut off only has to be seen to be there */
            big_multiply_add(&big, 10, 1);
            exponent--;
        }
        v = big_round(&big, (int)exponent);
    }
    *value = negative ? -v : v;
    return q;
}

const char *number_scan_any(const char *p, double *value)
{
    const char *q = read_number(p, value);
    return q && isfinite(*value) ? q : NULL;
}

bool parse_double(const char *text, size_t n, double *value)
{
    char few[128];
    char *copy = n + TEXT_PADDING <= sizeof few ? few : malloc(n + TEXT_PADDING);
    if (!copy) return false;
    if (n) memcpy(copy, text, n);
    memset(copy + n, 0, TEXT_PADDING);
    char *p = number_scan(copy, value);
    bool all = p && p == copy + n;
    if (copy != few) free(copy);
    return all;
}

const char *number_fault(char *p)
{
    double value;
    char *end = skip_token(p);
    const char *q = read_number(p, &value);
    if (q == end && isinf(value)) return "is too large";
    if (q && *q == ',') return "has a decimal comma";
    return "is not a number";
}

Quoted quote(const char *s, size_t n)
{
    Quoted q;
    size_t room = sizeof q.text - 4, k = n < room ? n : room;
    for (size_t i = 0; i < k; i++) q.text[i] = (unsigned char)s[i] < 32 || s[i] == 127 ? '?' : s[i];
    memcpy(q.text + k, n > k ? "..." : "", n > k ? 4 : 1);
    return q;
}

Quoted quote_token(char *p)
{
    return quote(p, (size_t)(skip_token(p) - p));
}

/* Warnings. */

void note_name(Notes *notes, const char *path, unsigned long line, const char *kind, const char *name, size_t n)
{
    Quoted quoted = quote(name, n);
    for (int i = 0; i < notes->n; i++) {
        Note *old = &notes->note[i];
        if (strcmp(old->kind, kind) == 0 && strcmp(old->path, path) == 0 && strcmp(old->name.text, quoted.text) == 0) {
            old->count++;
            return;
        }
    }
    if (notes->n < (int)(sizeof notes->note / sizeof notes->note[0]))
        notes->note[notes->n++] = (Note){ .path = path, .kind = kind, .name = quoted, .line = line, .count = 1 };
    else notes->dropped++;
}

void note(Notes *notes, const char *path, unsigned long line, const char *kind)
{
    note_name(notes, path, line, kind, "", 0);
}

void notes_print(const Notes *notes, Report *report)
{
    for (int i = 0; i < notes->n; i++) {
        const Note *n = &notes->note[i];
        char again[64] = "";
        if (n->count > 1) snprintf(again, sizeof again, " (%lu times)", n->count);
        const char *mark = n->name.text[0] ? "'" : "";
        report_warning(report, n->path, n->line, "%s%s%s%s%s%s", n->kind, mark[0] ? " " : "", mark, n->name.text, mark, again);
    }
    if (notes->dropped) report_warning(report, NULL, 0, "%lu warnings of further kinds", notes->dropped);
}

/* Names: open addressing, at most half full. */

static uint32_t hash(const char *s, size_t n)
{
    uint32_t h = 2166136261u;          /* FNV-1a */
    for (size_t i = 0; i < n; i++) h = (h ^ (unsigned char)s[i]) * 16777619u;
    return h ^ h >> 15;
}

/* The slot where the string is or would be; there must be slots. */
static uint32_t *names_slot(const Names *names, const char *s, size_t n)
{
    uint32_t i = hash(s, n) & (names->slots - 1);
    for (;; i = (i + 1) & (names->slots - 1)) {
        uint32_t k = names->slot[i];
        if (k == BVH_NONE || (strncmp(names->name[k], s, n) == 0 && names->name[k][n] == 0)) return &names->slot[i];
    }
}

uint32_t names_find(const Names *names, const char *s, size_t n)
{
    return names->slots ? *names_slot(names, s, n) : BVH_NONE;
}

uint32_t names_add(Names *names, const char *s, size_t n)
{
    if (2 * (size_t)names->n >= names->slots) {
        if (names->slots >= (uint32_t)1 << 30) return BVH_NONE;
        uint32_t slots = names->slots ? 2 * names->slots : 64;
        uint32_t *slot = malloc(slots * sizeof *slot);
        if (!slot) return BVH_NONE;
        for (uint32_t i = 0; i < slots; i++) slot[i] = BVH_NONE;
        free(names->slot);
        names->slot = slot;
        names->slots = slots;
        for (uint32_t k = 0; k < names->n; k++) *names_slot(names, names->name[k], strlen(names->name[k])) = k;
    }
    uint32_t *slot = names_slot(names, s, n);
    if (*slot != BVH_NONE) return *slot;
    if (names->n == names->capacity && !array_grow(&names->name, names->n, &names->capacity, sizeof *names->name, 0)) return BVH_NONE;
    char *copy = malloc(n + 1);
    if (!copy) return BVH_NONE;
    if (n) memcpy(copy, s, n);
    copy[n] = 0;
    names->name[names->n] = copy;
    return *slot = names->n++;
}

void names_free(Names *names)
{
    for (uint32_t i = 0; i < names->n; i++) free(names->name[i]);
    free(names->name);
    free(names->slot);
}

bool array_grow(void *array, uint32_t n, uint32_t *capacity, size_t item_size, uint64_t likely)
{
    if (n < *capacity) return true;
    if (n >= UINT32_MAX - 1) return false;
    uint32_t more = n < 256 ? 256 : n > UINT32_MAX / 2 ? UINT32_MAX - 1 : n + n / 2;
    void *old, *moved = NULL;
    memcpy(&old, array, sizeof old);   /* array is a T **; memcpy, as void * and T * may not alias */
    if (likely > more - n && likely < UINT32_MAX - 1 - n && n + likely <= SIZE_MAX / item_size && (moved = realloc(old, (n + (size_t)likely) * item_size)))
        more = n + (uint32_t)likely;
    if (!moved && (more > SIZE_MAX / item_size || !(moved = realloc(old, more * item_size)))) return false;
    large_pages(moved, more * item_size);
    memcpy(array, &moved, sizeof moved);
    *capacity = more;
    return true;
}

/* Files that a line names. */

static char *find_beside(const char *from, const char *s, size_t n)
{
    const char *slash = strrchr(from, '/');
    size_t folder = slash && !(n > 0 && s[0] == '/') ? (size_t)(slash - from) + 1 : 0;
    char *path = malloc(folder + n + 1);
    if (!path) return NULL;
    memcpy(path, from, folder);
    memcpy(path + folder, s, n);
    path[folder + n] = 0;
    struct stat status;
    for (int attempt = 0; attempt < 2; attempt++) {
        if (stat(path, &status) == 0 && S_ISREG(status.st_mode)) return path;
        for (char *p = path + folder; *p; p++) if (*p == '\\') *p = '/';
    }
    free(path);
    return NULL;
}

char *text_find_file(const char *from, const char *s, size_t n)
{
    for (;;) {
        char *path = find_beside(from, s, n);
        const char *quoted_end = n > 1 && s[0] == '"' ? memchr(s + 1, '"', n - 1) : NULL;
        if (!path && quoted_end) path = find_beside(from, s + 1, (size_t)(quoted_end - s) - 1);
        size_t k = before_comment(s, n);
        if (path || k == n) return path;
        n = k;
    }
}
