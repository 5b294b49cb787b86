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

/* Append the runs of one row, and return their number. */
static int32_t runs_of_row(const uint8_t *row, int32_t width, int32_t y, Run *runs) {
    int32_t count = 0, x = 0;
    while (x < width) {
        const uint8_t *start = memchr(row + x, DARK, (size_t)(width - x));
        if (!start) break;
        const int32_t from = (int32_t)(start - row);
        const uint8_t *end = memchr(start, 0, (size_t)(width - from));
        x = end ? (int32_t)(end - row) : width;
        runs[count++] = (Run){from, x, y, -1};
    }
    return count;
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

/* Follow the outer boundary of a region from its first pixel, anticlockwise in the image.
 *
 * Border following by Suzuki and Abe (1985), in the order of cv2.findContours with CHAIN_APPROX_NONE. Directions are
 * numbered anticlockwise from +x. A pixel is visited at most four times, which bounds the time and `max_points`.
 */
int trace(const Mask *mask, const Region *region, Workspace *work, Boundary *boundary) {
    static const int32_t dx[8] = {1, 1, 0, -1, -1, -1, 0, 1}, dy[8] = {0, -1, -1, -1, 0, 1, 1, 1};
    ptrdiff_t steps[8];
    for (int k = 0; k < 8; k++) steps[k] = dx[k] + dy[k] * mask->stride;
    Point at = {region->first_x, region->top};
    const uint8_t *const first = mask_row(mask, at.y) + at.x, *pixel = first;
    int direction = 4, tried = 0;
    do direction = (direction + 7) & 7; /* clockwise from the left neighbour, which is not dark */
    while (!first[steps[direction]] && ++tried < 8);
    const uint8_t *const last = first + steps[direction];
    int32_t count = 0;
    for (;;) {
        if (count >= work->max_points) return TOO_MANY_RESULTS;
        work->points[count++] = at;
        if (tried == 8) break; /* a single pixel */
        do direction = (direction + 1) & 7;
        while (!pixel[steps[direction]]);
        const uint8_t *next = pixel + steps[direction];
        if (next == first && pixel == last) break;
        at.x += dx[direction];
        at.y += dy[direction];
        pixel = next;
        direction = (direction + 4) & 7;
    }
    *boundary = (Boundary){work->points, count};
    return 0;
}
