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

/* Memory that starts a line, or NULL; free with free. Of 2 MB and more it is asked for in large pages: they save many misses of the address cache. */
void *large_alloc(size_t bytes);
#endif
