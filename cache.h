/* Hints to the memory system; they change no result. Used by ray queries and by paths that land on the film. */
#ifndef CACHE_H
#define CACHE_H

/* The line of memory at p will be read soon. */
#ifdef __GNUC__
static inline void prefetch_line(const void *p) { __builtin_prefetch(p); }
#else
static inline void prefetch_line(const void *p) { (void)p; }
#endif
#endif
