/* Light rectangles that explain the readings of a dark square best (vision/photometric/evidence/rectangles.py).
 *
 * A rectangle is a stretch down times a stretch along, each from one edge of a grid to another. The sum of a square's
 * readings over it is `sum(a, c) - sum(a, d) - sum(b, c) + sum(b, d)` with sums over what lies beyond pairs of edges. The
 * square of that sum, over the part of the rectangle that the ground does not explain, is what the rectangle explains.
 */
#include "pattern_fit.h"

enum { MAX_EDGES = 128, MAX_STRETCHES = MAX_EDGES * (MAX_EDGES - 1) / 2, MIN_STEPS = 2 };

/* The `each` rectangles with the greatest gains so far, in no order; `least` is the place of the smallest gain. */
typedef struct { double *gains; int32_t *rectangles; int32_t each, least; } Greatest;

static void keep(Greatest *kept, double gain, int32_t rectangle) {
    kept->gains[kept->least] = gain;
    kept->rectangles[kept->least] = rectangle;
    for (int32_t k = 0; k < kept->each; k++)
        if (kept->gains[k] < kept->gains[kept->least]) kept->least = k;
}

/* Write what all rectangles of one stretch down explain: `beyond` (edges,) are sums over the stretch. */
static void explain_stretch(const double *beyond, int32_t edges, const double *unexplained, double *gains) {
    for (int32_t low = 0; low + MIN_STEPS < edges; low++) {
        const double first = beyond[low];
        for (int32_t high = low + MIN_STEPS; high < edges; high++) {
            const double sum = first > beyond[high] ? first - beyond[high] : 0.0;
            *gains++ = sum * sum / *unexplained++;
        }
    }
}

static void find_greatest(const double *sums, int32_t edges, int32_t stretches, const double *unexplained, Greatest *kept) {
    double beyond[MAX_EDGES], gains[MAX_STRETCHES];
    int32_t row = 0;
    for (int32_t low = 0; low + MIN_STEPS < edges; low++)
        for (int32_t high = low + MIN_STEPS; high < edges; high++, row++) {
            for (int32_t k = 0; k < edges; k++) beyond[k] = sums[low * edges + k] - sums[high * edges + k];
            explain_stretch(beyond, edges, unexplained + (int64_t)row * stretches, gains);
            for (int32_t column = 0; column < stretches; column++)
                if (gains[column] > kept->gains[kept->least]) keep(kept, gains[column], row * stretches + column);
        }
}

/* Find the rectangles with the greatest gains for each square.
 *
 * sums (count, edges, edges) are those beyond pairs of edges, down and along; unexplained (stretches, stretches) has the
 * stretches of at least two steps in the order of their first and last edges. rectangles and gains (count, each) are row *
 * stretches + column, in no order. Returns 0 or an error. */
int32_t best_rectangles(const double *sums, int64_t count, int32_t edges, const double *unexplained, int32_t each,
                        int32_t *rectangles, double *gains) {
    if (count < 0 || each <= 0 || edges <= MIN_STEPS || edges > MAX_EDGES) return FIT_INVALID_SIZE;
    const int32_t stretches = (edges - 1) * (edges - MIN_STEPS) / 2;
    if (each > stretches * stretches) return FIT_INVALID_SIZE;
    for (int64_t k = 0; k < count; k++) {
        Greatest kept = {gains + k * each, rectangles + k * each, each, 0};
        for (int32_t place = 0; place < each; place++) kept.gains[place] = -1, kept.rectangles[place] = 0;
        find_greatest(sums + k * edges * edges, edges, stretches, unexplained, &kept);
    }
    return 0;
}
