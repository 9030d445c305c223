/* The search for the fewest lines in a tube: links.c for one channel, vectors.c for several. */
#ifndef HAPFMT_LINKS_H
#define HAPFMT_LINKS_H

#include "tube.h"

enum { TRIES = 2, SHORT = 16, SLACK = 32, WAYS = 16, CANDIDATES = 16 };

/* low and high, here and below, are places on the grid of values. */
typedef struct {
    int64_t low, high;
    size_t knot;
} part;

typedef struct {
    int64_t low, high;
    size_t parts;
    int32_t tick;
    int part_count;
} knot;

/* A knot, and the lines that begin there. */
typedef struct {
    size_t knot;
    sweep lines;
} way;

typedef struct {
    way ways[WAYS];
    int size;
} generation;

typedef struct {
    tube in;
    grid values;
    knot *knots;
    part *parts;
    size_t knot_count, knot_room, part_count, part_room;
    hull below, above;
    generation generations[2];
    sweep ahead;
} search;

/* The most places without a gap that lines reach at ``tick``, and where they come from. */
typedef struct {
    part parts[WAYS];
    int64_t low, high;
    int32_t tick;
    int begin, end;
} meeting;

/* Room for a search, whose memory is all zeros, and its first knot; -1: no memory. Closed in any
   case. */
int hapfmt_open(search *s, const tube *in, const grid *g);
void hapfmt_close(search *s);

/* Whether the grid has a value within the tube at every tick. */
int hapfmt_reaches(const grid *g, const tube *in);

/* The least and the largest place of a knot from which the line to ``place`` at ``tick`` decodes
   inside the tube; least > largest where there is none, and then they may be wider than the twin's
   where ``early`` allows to stop there. */
void hapfmt_origins(const search *s, const knot *from, int32_t tick, int64_t place, int early,
                    int64_t *least, int64_t *most);

/* The places at ``tick`` that those of the way's knot reach; 0: none. */
int hapfmt_arrive(const search *s, const way *w, int32_t tick, part *out);

/* A knot more; -1: no memory. */
int hapfmt_keep(search *s, const meeting *m);

/* All lines that begin at the knot found last; -1: no memory. */
int hapfmt_add_way(search *s, generation *g);

/* Ticks for the knot after the way's, best first, and the stop that satisfies; -1: no memory. */
int hapfmt_candidates(search *s, const way *w, int32_t *ticks, int32_t *enough);

#endif
