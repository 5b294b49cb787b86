/* Regions of dark pixels that touch at a side or a corner, and their outer boundaries. */
#include "search.h"

#include <string.h>

/* Return the region that a region was joined with, and shorten the path to it. */
static int32_t root(Region *regions, int32_t label) {
    while (regions[label].parent != label) {
        regions[label].parent = regions[regions[label].parent].parent;
        label = regions[label].parent;
    }
    return label;
}

static int32_t smaller(int32_t a, int32_t b) { return a < b ? a : b; }
static int32_t larger(int32_t a, int32_t b) { return a > b ? a : b; }

/* Join two regions. The first pixel of the union is that of the earlier region, which has the smaller label. */
static int32_t join(Region *regions, int32_t a, int32_t b) {
    const int32_t first = smaller(a, b), other = larger(a, b);
    if (first == other) return first;
    Region *kept = regions + first;
    const Region *joined = regions + other;
    kept->left = smaller(kept->left, joined->left);
    kept->right = larger(kept->right, joined->right);
    kept->bottom = larger(kept->bottom, joined->bottom);
    regions[other].parent = first;
    return first;
}

/* Return which of 64 pixels, 0 or 255, are dark: bit i is pixel i. */
static uint64_t dark_bits(const uint8_t *pixels) {
    enum { BYTES = 8 };
    uint64_t bits = 0;
    for (int part = 0; part < BYTES; part++, pixels += BYTES) {
        uint64_t eight = 0; /* one load on little-endian processors */
        for (int i = 0; i < BYTES; i++) eight |= (uint64_t)pixels[i] << (BYTES * i);
        /* The product has the lowest bits of the eight bytes in its highest byte. */
        bits |= (eight & 0x0101010101010101u) * 0x0102040810204080u >> 56 << (BYTES * part);
    }
    return bits;
}

/* Append the runs of one row, and return their number. A run begins and ends where a pixel differs from the last one. */
static int32_t runs_of_row(const uint8_t *row, int32_t width, int32_t y, Run *runs) {
    enum { BITS = 64 };
    uint8_t rest[BITS] = {0};
    int32_t ends = 0;
    uint64_t last = 0; /* whether the pixel before is dark */
    for (int32_t x = 0; x < width; x += BITS) {
        const int is_whole = width - x >= BITS;
        if (!is_whole) memcpy(rest, row + x, (size_t)(width - x));
        const uint64_t dark = dark_bits(is_whole ? row + x : rest);
        for (uint64_t changes = dark ^ (dark << 1 | last); changes; changes &= changes - 1, ends++) {
            const int32_t at = x + __builtin_ctzll(changes);
            if (ends % 2) runs[ends / 2].to = at;
            else runs[ends / 2] = (Run){at, width, y, -1};
        }
        last = dark >> (BITS - 1);
    }
    return (ends + 1) / 2;
}

/* Extend the region of a run, or begin a new one. Return the number of regions. */
static int32_t extend(Region *regions, int32_t count, Run *run) {
    if (run->label < 0) {
        run->label = count;
        regions[count] = (Region){count, run->from, run->to - 1, run->y, run->y, run->from};
        return count + 1;
    }
    Region *region = regions + run->label;
    region->left = smaller(region->left, run->from);
    region->right = larger(region->right, run->to - 1);
    region->bottom = run->y;
    return count;
}

/* Find the regions of a mask. Return their number; those with another parent than themselves were joined. */
int32_t find_regions(const Mask *mask, Workspace *work) {
    Region *regions = work->regions;
    Run *before = work->runs, *now = work->runs + mask->width;
    int32_t count = 0, before_count = 0;
    for (int32_t y = 0; y < mask->height; y++) {
        const int32_t now_count = runs_of_row(mask_row(mask, y), mask->width, y, now);
        int32_t first = 0;
        for (int32_t i = 0; i < now_count; i++) {
            Run *run = now + i;
            while (first < before_count && before[first].to < run->from) first++;
            for (int32_t k = first; k < before_count && before[k].from <= run->to; k++) {
                const int32_t above = root(regions, before[k].label);
                run->label = run->label < 0 ? above : join(regions, root(regions, run->label), above);
            }
            count = extend(regions, count, run);
        }
        Run *swap = before;
        before = now;
        now = swap;
        before_count = now_count;
    }
    return count;
}

/* Directions are numbered anticlockwise from +x. */
static const int32_t DX[8] = {1, 1, 0, -1, -1, -1, 0, 1}, DY[8] = {0, -1, -1, -1, 0, 1, 1, 1};

/* Return which of a pixel's neighbours are dark, one bit for each direction. Pixels are 0 or 255. */
static inline uint32_t dark_neighbours(const uint8_t *pixel, const ptrdiff_t steps[8]) {
    uint32_t bits = 0;
    for (int direction = 0; direction < 8; direction++) bits |= pixel[steps[direction]] & 1u << direction;
    return bits;
}

/* Return the first direction of a neighbour's bit, at least one, from `direction` on. */
static inline int first_from(int direction, uint32_t bits) {
    return (direction + __builtin_ctz((bits << 8 | bits) >> direction)) & 7;
}

/* Follow the outer boundary of a region from its first pixel, anticlockwise in the image.
 *
 * Border following by Suzuki and Abe (1985), in the order of cv2.findContours with CHAIN_APPROX_NONE. A pixel is visited
 * at most four times. Returns 0 for a boundary of more than `max_points`.
 */
int trace(const Mask *mask, const Region *region, ptrdiff_t max_points, Workspace *work, Boundary *boundary) {
    ptrdiff_t steps[8];
    for (int k = 0; k < 8; k++) steps[k] = DX[k] + DY[k] * mask->stride;
    Point at = {region->first_x, region->top};
    const uint8_t *const first = mask_row(mask, at.y) + at.x, *pixel = first;
    const uint32_t around = dark_neighbours(first, steps);
    work->points[0] = at;
    *boundary = (Boundary){work->points, 1};
    if (!around) return max_points > 0;
    /* The last step leads from the first dark pixel clockwise from the left neighbour, which is not dark. */
    int direction = 4;
    do direction = (direction + 7) & 7;
    while (!(around >> direction & 1));
    const uint8_t *const last = first + steps[direction];
    int32_t count = 0;
    for (;;) {
        if (count >= max_points) return 0;
        work->points[count++] = at;
        direction = first_from((direction + 1) & 7, dark_neighbours(pixel, steps));
        const uint8_t *next = pixel + steps[direction];
        if (next == first && pixel == last) break;
        at.x += DX[direction];
        at.y += DY[direction];
        pixel = next;
        direction = (direction + 4) & 7;
    }
    boundary->count = count;
    return 1;
}
