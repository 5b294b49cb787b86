/* Corners of dark quadrilaterals from the gradient along normals of their sides.
 *
 * On each normal, the edge is the centroid of the squared brightening outwards. A line is fitted to the edges of a side by
 * iteratively reweighted least squares with Tukey's biweight, with one spread for all sides. The corners are the lines'
 * intersections. This is repeated about the last lines. */
#include "sampling.h"
#include "search.h"

#include <math.h>

enum { SIDES = 4, MAX_NORMALS = PLACES_AT_ONCE, MAX_STEPS = 64, MAX_ROUNDS = 64 };

/* A side from its first corner on: unit vectors along it and outwards, and its length, px. */
typedef struct { Place corner, along, outward; double length; } Side;

/* Edges on the normals of all sides: places along a side, in sides from its middle; px outwards; weights. */
typedef struct {
    double along[MAX_NORMALS], edges[SIDES][MAX_NORMALS], weights[SIDES][MAX_NORMALS];
    double rises[SIDES * MAX_NORMALS];
} Normals;

/* Lines `shift + tilt * along` through the edges of each side, px outwards, with their spread and share of inliers. */
typedef struct { double shifts[SIDES], tilts[SIDES], spread, support; } Lines;

static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }

/* Return the value of a rank of `count` values, which are reordered: none before it is larger (Hoare, 1961). */
static double ranked(double *values, int count, int rank) {
    for (int low = 0, high = count - 1; low < high;) {
        const double pivot = values[rank];
        int i = low, k = high;
        while (i <= k) {
            while (values[i] < pivot) i++;
            while (pivot < values[k]) k--;
            if (i > k) break;
            const double swap = values[i];
            values[i++] = values[k];
            values[k--] = swap;
        }
        if (k < rank) low = i;
        if (rank < i) high = k;
    }
    return values[rank];
}

/* Return the median of at least one value; they are reordered. */
static double median(double *values, int count) {
    const double upper = ranked(values, count, count / 2);
    if (count % 2) return upper;
    double lower = values[0];
    for (int i = 1; i < count / 2; i++) lower = larger(lower, values[i]);
    return (lower + upper) / 2;
}

static Side side_of(const Place *corners, int number, double min_divisor) {
    const Place from = corners[number], to = corners[(number + 1) % SIDES];
    const double u = to.u - from.u, v = to.v - from.v, length = larger(sqrt(u * u + v * v), min_divisor);
    return (Side){from, {u / length, v / length}, {v / length, -u / length}, length};
}

/* Find the edges on the normals of a side, up to `reach_px` on either side of it: at first all normals at one step. */
static void read_normals(const uint8_t *image, int32_t width, int32_t height, Side side, double reach_px,
                         const EdgeParameters *given, int number, Normals *normals) {
    const double step_px = reach_px / given->steps;
    const int32_t count = given->normals;
    double u[MAX_NORMALS], v[MAX_NORMALS], total[MAX_NORMALS] = {0}, moment[MAX_NORMALS] = {0}, rise[MAX_NORMALS] = {0};
    float before[MAX_NORMALS], grey[MAX_NORMALS];
    for (int k = -given->steps; k <= given->steps; k++) {
        const double out = k * step_px, middle = out - step_px / 2;
        for (int32_t i = 0; i < count; i++) {
            const double at = (normals->along[i] + 0.5) * side.length;
            u[i] = side.corner.u + at * side.along.u + out * side.outward.u;
            v[i] = side.corner.v + at * side.along.v + out * side.outward.v;
        }
        read_grey(image, width, height, u, v, count, grey);
        for (int32_t i = 0; i < count && k > -given->steps; i++) {
            const double difference = (double)grey[i] - (double)before[i], brighter = difference > 0 ? difference : 0.0;
            rise[i] += brighter;
            total[i] += brighter * brighter;
            moment[i] += brighter * brighter * middle;
        }
        memcpy(before, grey, sizeof before);
    }
    for (int32_t i = 0; i < count; i++) {
        normals->edges[number][i] = moment[i] / larger(total[i], given->min_divisor);
        normals->weights[number][i] = sqrt(total[i]);
        normals->rises[number * count + i] = rise[i];
    }
}

/* Divide the weights of a side by their median, up to 1. */
static void limit_weights(double *weights, const EdgeParameters *given) {
    double ordered[MAX_NORMALS];
    for (int i = 0; i < given->normals; i++) ordered[i] = weights[i];
    const double usual = larger(median(ordered, given->normals), given->min_divisor);
    for (int i = 0; i < given->normals; i++) weights[i] = smaller(weights[i] / usual, 1.0);
}

/* Fit a line to weighted edges of a side, and write what it leaves of each. */
static void fit_side(const Normals *normals, int number, const double *weights, const EdgeParameters *given, Lines *lines,
                     double *left) {
    const double *edges = normals->edges[number];
    double total = 0, x = 0, y = 0, xy = 0, xx = 0;
    for (int i = 0; i < given->normals; i++)
        total += weights[i], x += weights[i] * normals->along[i], y += weights[i] * edges[i];
    x /= larger(total, given->min_divisor), y /= larger(total, given->min_divisor);
    for (int i = 0; i < given->normals; i++) {
        const double along = normals->along[i] - x;
        xy += weights[i] * along * (edges[i] - y), xx += weights[i] * along * along;
    }
    const double tilt = xy / larger(xx, given->min_divisor);
    for (int i = 0; i < given->normals; i++) left[i] = edges[i] - y - tilt * (normals->along[i] - x);
    lines->tilts[number] = tilt;
    lines->shifts[number] = y - tilt * x;
}

/* Fit lines to the edges of all sides; those far off, in terms of the spread of all, have little weight. */
static Lines fit_lines(Normals *normals, const EdgeParameters *given) {
    Lines lines = {{0}, {0}, 0, 0};
    double current[SIDES][MAX_NORMALS], left[SIDES][MAX_NORMALS], sizes[SIDES * MAX_NORMALS];
    for (int side = 0; side < SIDES; side++) {
        limit_weights(normals->weights[side], given);
        for (int i = 0; i < given->normals; i++) current[side][i] = normals->weights[side][i];
    }
    const int count = SIDES * given->normals;
    for (int round = 0; round < given->reweightings; round++) {
        for (int side = 0, at = 0; side < SIDES; side++) {
            fit_side(normals, side, current[side], given, &lines, left[side]);
            for (int i = 0; i < given->normals; i++) sizes[at++] = fabs(left[side][i]);
        }
        lines.spread = larger(median(sizes, count) / given->median_per_sigma, given->min_spread_px);
        int inliers = 0;
        for (int side = 0; side < SIDES; side++)
            for (int i = 0; i < given->normals; i++) {
                const double away = left[side][i] / (given->tukey_sigmas * lines.spread), share = 1 - away * away;
                const double inlier = fabs(away) < 1 ? share * share : 0.0;
                current[side][i] = normals->weights[side][i] * inlier;
                inliers += inlier > given->min_inlier_weight;
            }
        lines.support = (double)inliers / count;
    }
    return lines;
}

/* Move corners to the intersections of adjacent lines; those of nearly parallel ones stay. */
static void meet(const Side *sides, const Lines *lines, double min_crossing, Place *corners) {
    Place points[SIDES], along[SIDES];
    for (int i = 0; i < SIDES; i++) {
        const Side side = sides[i];
        const double half = side.length / 2, shift = lines->shifts[i], turn = lines->tilts[i] / side.length;
        points[i] = (Place){side.corner.u + half * side.along.u + shift * side.outward.u,
                            side.corner.v + half * side.along.v + shift * side.outward.v};
        along[i] = (Place){side.along.u + turn * side.outward.u, side.along.v + turn * side.outward.v};
    }
    for (int i = 0; i < SIDES; i++) {
        const int before = (i + SIDES - 1) % SIDES;
        const Place its = along[before], own = along[i];
        const double crossing = its.u * own.v - its.v * own.u;
        if (!(fabs(crossing) > min_crossing)) continue;
        const double u = points[i].u - points[before].u, v = points[i].v - points[before].v;
        const double ahead = (u * own.v - v * own.u) / crossing;
        corners[i] = (Place){points[before].u + ahead * its.u, points[before].v + ahead * its.v};
    }
}

/* Return how far to look on either side of the lines, px, for markers of so many cells. */
static double reach_of(const Side *sides, int32_t cells, const EdgeParameters *given) {
    double mean = 0;
    for (int i = 0; i < SIDES; i++) mean += sides[i].length / SIDES;
    return smaller(larger(given->reach_cells * mean / cells, given->min_reach_px), given->max_reach_px);
}

/* Refine the corners (count, 4, 2), px, of dark quadrilaterals, clockwise in the image, of markers with `cells` a side.
 *
 * spreads (count,) receives the standard deviation of an edge about its line, px, supports the share of inliers, and rises
 * the median brightening along a normal, grey levels. Returns 0 or an error. */
int32_t fit_edges(const uint8_t *image, int32_t width, int32_t height, int64_t count, int32_t cells,
                  const EdgeParameters *given, double *corners, double *spreads, double *supports, double *rises) {
    if (width <= 0 || height <= 0 || width > MAX_SIDE_PX || height > MAX_SIDE_PX || count < 0) return INVALID_SIZE;
    if (cells <= 0 || given->normals <= 0 || given->normals > MAX_NORMALS || given->steps <= 0 || given->steps > MAX_STEPS ||
        given->rounds <= 0 || given->rounds > MAX_ROUNDS || given->reweightings <= 0 || given->reweightings > MAX_ROUNDS)
        return INVALID_PARAMETERS;
    Normals normals;
    for (int i = 0; i < given->normals; i++)
        normals.along[i] = given->end_share + (1 - 2 * given->end_share) * (i + 0.5) / given->normals - 0.5;
    for (int64_t k = 0; k < count; k++) {
        Place *quad = (Place *)(corners + 2 * SIDES * k);
        for (int round = 0; round < given->rounds; round++) {
            Side sides[SIDES];
            for (int i = 0; i < SIDES; i++) sides[i] = side_of(quad, i, given->min_divisor);
            const double reach_px = reach_of(sides, cells, given);
            for (int i = 0; i < SIDES; i++) read_normals(image, width, height, sides[i], reach_px, given, i, &normals);
            const Lines lines = fit_lines(&normals, given);
            spreads[k] = lines.spread;
            supports[k] = lines.support;
            rises[k] = median(normals.rises, SIDES * given->normals);
            meet(sides, &lines, given->min_crossing, quad);
        }
    }
    return 0;
}
