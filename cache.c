/* Memory for what is read in no order. See cache.h. */
#define _DEFAULT_SOURCE                /* for madvise */
#ifdef __linux__
#include <sys/mman.h>
#endif
#include "cache.h"
#include <stdint.h>
#include <stdlib.h>

static const size_t LARGE = (size_t)1 << 21;       /* bytes of a page */

void large_pages(void *p, size_t bytes)
{
#ifdef MADV_HUGEPAGE
    size_t skipped = -(uintptr_t)p % LARGE;    /* before the first whole one */
    if (bytes >= LARGE + skipped) madvise((char *)p + skipped, bytes - skipped, MADV_HUGEPAGE);
#else
    (void)p, (void)bytes;
#endif
}

void *large_alloc(size_t bytes)
{
    size_t page = bytes >= LARGE ? LARGE : 64, whole = (bytes + page - 1) / page * page;
    if (whole < bytes) return NULL;
    void *p = aligned_alloc(page, whole);
    if (p) large_pages(p, whole);
    return p;
}
