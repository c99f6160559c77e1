/* 'mlt explain': one real mutation, printed as the slides write it, with every number that its acceptance is made of; or the audit (audit.h).
 *
 * The sampler itself makes the step (chain_run); the same random numbers, replayed through the same row of the table, say what it did. What is
 * printed last on each line is the renderer's own number, before it are the numbers that it should be made of: they must multiply out.
 * Knows no options of the command line and no files. [lecture: An example; Example I fleshed out; Example 2] */
#ifndef EXPLAIN_H
#define EXPLAIN_H
#include "mlt.h"

typedef struct {
    const char *strategy;      /* name of a row of mutation_table; NULL for any, or for the audit of all */
    bool accepted;             /* only a mutation that the chain accepted */
    int length;                /* edges of x; 0 for any */
    int example;               /* 1 or 2: a mutation of exactly that example of the lecture; else 0 */
    bool audit;                /* the audit instead of a mutation */
    uint64_t proposals;        /* audit: proposals of each strategy; 0 = 50000 */
    uint64_t bootstrap;        /* bidirectional samples for the chains' seeds; 0 = 20000 */
    uint64_t seed;
} ExplainOptions;

/* Finds a mutation that meets the options and prints it, or prints the audit, to which accepted, length and example mean nothing.
 * The space's image-plane weight must be NULL. False with an error if there is none among the tries, or if the audit found anything off (what it
 * found is printed). */
bool explain(const Space *space, const Sampler *sampler, const ExplainOptions *options, FILE *out, Report *report);
#endif
