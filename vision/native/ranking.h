/* Numbers with the rows that they are of, to be sorted in ascending order. */
#ifndef SKYHERD_RANKING_H
#define SKYHERD_RANKING_H

#include <stdint.h>
#include <stdlib.h>

typedef struct { double value; int64_t row; } Ranked;

static inline int by_value(const void *a, const void *b) {
    const Ranked *one = a, *two = b;
    if (one->value != two->value) return one->value < two->value ? -1 : 1;
    return one->row < two->row ? -1 : one->row > two->row;
}

static inline void rank(Ranked *numbers, int64_t count) { qsort(numbers, (size_t)count, sizeof *numbers, by_value); }

#endif
