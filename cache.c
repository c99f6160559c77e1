/* Memory for what is read in no order. See cache.h. */
#define _DEFAULT_SOURCE                /* for madvise */
#ifdef __linux__
#include <sys/mman.h>
#endif
#include "cache.h"
#include <stdlib.h>

void *large_alloc(size_t bytes)
{
    size_t page = bytes >> 21 ? (size_t)1 << 21 : 64, whole = (bytes + page - 1) / page * page;
    if (whole < bytes) return NULL;
    void *p = aligned_alloc(page, whole);
#ifdef MADV_HUGEPAGE
    if (p && page > 64) madvise(p, whole, MADV_HUGEPAGE);
#endif
    return p;
}
