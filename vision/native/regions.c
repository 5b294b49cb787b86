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
    kept->filled += joined->filled;
    /* If both have runs in the row at hand, that of the left one counts: the other may lie in a hole that ends here. */
    if (kept->bottom == joined->bottom) kept->row_end = smaller(kept->row_end, joined->row_end);
    else if (kept->bottom < joined->bottom) kept->row_end = joined->row_end;
    kept->bottom = larger(kept->bottom, joined->bottom);
    regions[other].parent = first;
    return first;
}

/* Append the runs of one row, and return their number. A run begins and ends where a pixel differs from the last one. */
static int32_t runs_of_row(const uint8_t *row, int32_t width, int32_t y, Run *runs) {
    int32_t ends = 0;
    uint64_t last = 0; /* whether the pixel before is dark */
    for (int32_t x = 0; x < width; x += BITS) {
        const uint64_t dark = word_at(row, x);
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
        regions[count] = (Region){count, run->from, run->to - 1, run->y, run->y, run->from, run->to, run->to - run->from};
        return count + 1;
    }
    Region *region = regions + run->label;
    region->filled += run->to - (region->bottom == run->y ? region->row_end : run->from);
    region->row_end = run->to;
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
enum { DIRECTIONS = 8, NEIGHBOURHOODS = 256 };
static const int32_t DX[DIRECTIONS] = {1, 1, 0, -1, -1, -1, 0, 1}, DY[DIRECTIONS] = {0, -1, -1, -1, 0, 1, 1, 1};

/* The step that follows a step in a direction, by the dark neighbours of the pixel that it led to: the first dark one
 * anticlockwise from where it came from. */
typedef struct { int8_t dx, dy; uint8_t direction; } Step;
static Step next_steps[DIRECTIONS][NEIGHBOURHOODS];

/* Bits of the neighbours in each direction in `neighbours_at`. */
static const int32_t BIT_OF[DIRECTIONS] = {4, 2, 1, 0, 3, 5, 6, 7};

__attribute__((constructor)) static void fill_next_steps(void) {
    for (int32_t came = 0; came < DIRECTIONS; came++)
        for (int32_t dark = 0; dark < NEIGHBOURHOODS; dark++)
            for (int32_t turn = DIRECTIONS; turn > 0; turn--) {
                const int32_t direction = (came + DIRECTIONS / 2 + turn) % DIRECTIONS;
                const Step step = {(int8_t)DX[direction], (int8_t)DY[direction], (uint8_t)direction};
                if (dark >> BIT_OF[direction] & 1) next_steps[came][dark] = step;
            }
}

/* Return pixels x - 1 to x + 1 of a row as bits 0 to 2. */
static inline uint32_t three_at(const uint8_t *row, int32_t x) {
    const uint32_t first = (uint32_t)x + BITS_PER_BYTE - 1;
    uint16_t two_bytes;
    memcpy(&two_bytes, row - 1 + first / BITS_PER_BYTE, sizeof two_bytes);
    return (uint32_t)two_bytes >> first % BITS_PER_BYTE & 7u;
}

/* Return which neighbours of pixel x of a row are dark, as bits: three above it, both beside it, three below it. */
static inline uint32_t neighbours_at(const uint8_t *row, ptrdiff_t stride, int32_t x) {
    const uint32_t here = three_at(row, x);
    return three_at(row - stride, x) | (here & 1) << 3 | (here >> 2) << 4 | three_at(row + stride, x) << 5;
}

/* Follow the outer boundary of a region from its first pixel, anticlockwise in the image.
 *
 * Border following by Suzuki and Abe (1985), in the order of cv2.findContours with CHAIN_APPROX_NONE. A pixel is visited
 * at most four times. Returns 0 for a boundary of more than `max_points`.
 */
int trace(const Mask *mask, const Region *region, ptrdiff_t max_points, Workspace *work, Boundary *boundary) {
    const ptrdiff_t stride = mask->stride;
    const Point first = {region->first_x, region->top};
    const uint8_t *row = mask_row(mask, first.y);
    const uint32_t around = neighbours_at(row, stride, first.x);
    work->points[0] = first;
    *boundary = (Boundary){work->points, 1};
    if (!around) return max_points > 0;
    /* The last step leads from the first dark pixel clockwise from the left neighbour, which is not dark. */
    int direction = 4;
    do direction = (direction + 7) % DIRECTIONS;
    while (!(around >> BIT_OF[direction] & 1));
    const Point last = {first.x + DX[direction], first.y + DY[direction]};
    Point at = first;
    direction = (direction + DIRECTIONS / 2) % DIRECTIONS;
    for (int32_t count = 0;;) {
        if (count >= max_points) return 0;
        work->points[count++] = at;
        const Step *step = &next_steps[direction][neighbours_at(row, stride, at.x)];
        const Point next = {at.x + step->dx, at.y + step->dy};
        if (next.x == first.x && next.y == first.y && at.x == last.x && at.y == last.y) {
            boundary->count = count;
            return 1;
        }
        row += step->dy * stride;
        direction = step->direction;
        at = next;
    }
}
