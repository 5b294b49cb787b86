/* Pixels of markers, line by line, and their places on the marker.
 *
 * With a pixel's offset p from the centre, px, its marker coordinates are
 *
 *     z = (Re(X̄ p) + i Re(Ȳ p)) / (1 - Re(h̄ p))
 *
 * of the axes X and Y and the perspective h. A marker has the pixels where neither |x| nor |y| is above its limit. They lie
 * between two strips about its axes, which are wider by what the perspective adds: only these are looked through.
 */
#include "fit.h"

/* Smallest slope along a line, sides per px, that is divided by. Chosen far below 1 / image width, so that the bounds of
 * an axis at right angles to the line lie outside any image. */
static const double MIN_AXIS_PER_PX = 1e-12;

enum { CHUNK = 64 };

typedef struct { int64_t first, last; } Range;

static const Range NONE = {0, -1};

static int64_t full_blocks(int64_t pixels) { return (pixels + BLOCK_PX - 1) / BLOCK_PX; }

/* Return the whole numbers from `low` to `high` within 0 to `size - 1`. */
static Range whole_numbers(double low, double high, int64_t size) {
    if (!(low <= high)) return NONE;
    const double first = fmax(ceil(low), 0.0), last = fmin(floor(high), (double)size - 1.0);
    return first <= last ? (Range){(int64_t)first, (int64_t)last} : NONE;
}

/* Return the lines that may have pixels of a marker. A marker with numbers that are not finite has none. */
static Range lines_of(const Marker *marker, int64_t height) {
    const double total = magnitude(marker->center) + magnitude(marker->x_axis) + magnitude(marker->y_axis) +
                         magnitude(marker->perspective) + magnitude(marker->keystone) +
                         magnitude(marker->anisotropy) + marker->strip + marker->height_px + marker->sigma;
    if (!(total < INFINITY)) return NONE;
    return whole_numbers(marker->center.im - marker->height_px, marker->center.im + marker->height_px, height);
}

/* Return the columns of line v within both strips |Re(X̄ p)|, |Re(Ȳ p)| <= strip about the centre. */
static Range columns_of(const Marker *marker, int64_t v, int64_t width) {
    const double below = (double)v - marker->center.im;
    const Complex axes[2] = {marker->x_axis, marker->y_axis};
    double low = -INFINITY, high = INFINITY;
    for (int i = 0; i < 2; i++) {
        const double per_u = fabs(axes[i].re) > MIN_AXIS_PER_PX ? axes[i].re : MIN_AXIS_PER_PX;
        const double middle = -axes[i].im / per_u * below, half = marker->strip / fabs(per_u);
        low = fmax(low, middle - half);
        high = fmin(high, middle + half);
    }
    return whole_numbers(low + marker->center.re, high + marker->center.re, width);
}

/* Return the number of blocks of pixels between the strips of markers: at least that of `list_pixels`. */
int64_t count_blocks(const Marker *markers, int64_t count, int64_t height, int64_t width) {
    int64_t blocks = 0;
    for (int64_t k = 0; k < count; k++) {
        const Range lines = lines_of(markers + k, height);
        int64_t pixels = 0;
        for (int64_t v = lines.first; v <= lines.last; v++) {
            const Range columns = columns_of(markers + k, v, width);
            pixels += columns.last - columns.first + 1;
        }
        blocks += full_blocks(pixels);
    }
    return blocks;
}

/* Compute marker coordinates of `length` pixels of line v from column u on, and whether each is the marker's. */
static void places_of(const Marker *marker, int64_t v, int64_t u, int64_t length, double *x, double *y, double *within) {
    const Complex X = marker->x_axis, Y = marker->y_axis, h = marker->perspective;
    const double below = (double)v - marker->center.im, begin = (double)u - marker->center.re;
    for (int64_t i = 0; i < length; i++) {
        const double right = begin + (double)i, far = 1 / (1 - (h.re * right + h.im * below));
        x[i] = (X.re * right + X.im * below) * far;
        y[i] = (Y.re * right + Y.im * below) * far;
        within[i] = ((far > 0) & (fabs(x[i]) <= marker->limit) & (fabs(y[i]) <= marker->limit)) ? 1.0 : 0.0;
    }
}

/* Where the pixels of a marker are written: blocks, and how many pixels there are. */
typedef struct { float *places; int32_t *pixels; int64_t count; } List;

/* Append `length` pixels of line v from column u on, block by block. */
static void append(List *list, const double *x, const double *y, int64_t length, int64_t v, int64_t u) {
    while (length > 0) {
        const int64_t begin = list->count % BLOCK_PX, at = list->count / BLOCK_PX * (2 * BLOCK_PX) + begin;
        const int64_t part = BLOCK_PX - begin < length ? BLOCK_PX - begin : length;
        float *restrict places = list->places + at;
        int32_t *restrict pixels = list->pixels + at;
        for (int64_t i = 0; i < part; i++) {
            places[i] = (float)x[i];
            places[i + BLOCK_PX] = (float)y[i];
            pixels[i] = (int32_t)v;
            pixels[i + BLOCK_PX] = (int32_t)(u + i);
        }
        list->count += part, length -= part, x += part, y += part, u += part;
    }
}

/* Append the pixels of a marker in line v. They follow each other, since a line crosses a quadrilateral once. */
static void append_line(const Marker *marker, int64_t v, Range columns, List *list) {
    double x[CHUNK], y[CHUNK], within[CHUNK];
    for (int64_t u = columns.first; u <= columns.last; u += CHUNK) {
        const int64_t rest = columns.last - u + 1, length = rest < CHUNK ? rest : CHUNK;
        int64_t first = 0, end = length;
        places_of(marker, v, u, length, x, y, within);
        while (first < end && within[first] == 0.0) first++;
        while (first < end && within[end - 1] == 0.0) end--;
        append(list, x + first, y + first, end - first, v, u + first);
    }
}

/* Repeat the last pixel until its block is full. */
static void fill_last_block(List list) {
    if (list.count % BLOCK_PX == 0) return;
    const int64_t block = list.count / BLOCK_PX * (2 * BLOCK_PX), last = block + list.count % BLOCK_PX - 1;
    const double x = (double)list.places[last], y = (double)list.places[last + BLOCK_PX];
    const int32_t v = list.pixels[last], u = list.pixels[last + BLOCK_PX];
    while (list.count % BLOCK_PX) append(&list, &x, &y, 1, v, u);
}

/* List the pixels of markers without gaps but in their last blocks.
 *
 * bounds (count + 1,), counts (count,), places and pixels (room, 2, BLOCK_PX) are results, as in `MarkerBlocks`. Returns the
 * number of blocks, or an error. */
int64_t list_pixels(const Marker *markers, int64_t count, int64_t height, int64_t width, int64_t *bounds, int64_t *counts,
                    float *places, int32_t *pixels, int64_t room) {
    bounds[0] = 0;
    for (int64_t k = 0; k < count; k++) {
        const int64_t begin = bounds[k] * (2 * BLOCK_PX);
        List list = {places + begin, pixels + begin, 0};
        const Range lines = lines_of(markers + k, height);
        for (int64_t v = lines.first; v <= lines.last; v++) {
            const Range columns = columns_of(markers + k, v, width);
            const int64_t most = list.count + columns.last - columns.first + 1;
            if (full_blocks(most) > room - bounds[k]) return FIT_INVALID_SIZE;
            append_line(markers + k, v, columns, &list);
        }
        fill_last_block(list);
        counts[k] = list.count;
        bounds[k + 1] = bounds[k] + full_blocks(list.count);
    }
    return bounds[count];
}

/* Return whether the bounds of markers ascend from 0 or more to `blocks` at most, and fit their numbers of pixels. */
int are_bounds_valid(const MarkerBlocks *given) {
    if (given->count < 0 || given->blocks < 0 || given->bounds[0] < 0 || given->bounds[given->count] > given->blocks)
        return 0;
    for (int64_t k = 0; k < given->count; k++) {
        const int64_t blocks = given->bounds[k + 1] - given->bounds[k];
        if (blocks < 0 || given->counts[k] > blocks * BLOCK_PX || full_blocks(given->counts[k]) != blocks) return 0;
    }
    return 1;
}
