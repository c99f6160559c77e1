/* Hints to the memory system; they change no result. Used by ray queries, and by all that lands on the film. */
#ifndef CACHE_H
#define CACHE_H
#include <stddef.h>

/* The line of memory at p will be read soon. */
#ifdef __GNUC__
static inline void prefetch_line(const void *p) { __builtin_prefetch(p); }
#else
static inline void prefetch_line(const void *p) { (void)p; }
#endif

/* Asks for large pages where p[0..bytes-1] fills such (2 MB): they save many misses of the address cache, and many calls for memory not yet touched. */
void large_pages(void *p, size_t bytes);
/* Memory that starts a line, or NULL, in large pages if it fills one; free with free. */
void *large_alloc(size_t bytes);
#endif
