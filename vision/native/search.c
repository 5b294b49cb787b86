/* The functions that Python calls, and the layout of the workspace. */
#include "search.h"

#include <math.h>
#include <string.h>

enum { ALIGNMENT = 64 };

static int valid_size(int32_t width, int32_t height) {
    return width > 0 && height > 0 && width <= MAX_SIDE_PX && height <= MAX_SIDE_PX && width % 2 == 0 &&
           height % 2 == 0 && (int64_t)width * height <= MAX_PIXELS;
}

/* Under AddressSanitizer, only the reserved parts of the workspace may be accessed. */
#if defined(__SANITIZE_ADDRESS__)
void __asan_poison_memory_region(const volatile void *begin, size_t bytes);
void __asan_unpoison_memory_region(const volatile void *begin, size_t bytes);
static void forbid(const void *begin, size_t bytes) { __asan_poison_memory_region(begin, bytes); }
static void allow(const void *begin, size_t bytes) { __asan_unpoison_memory_region(begin, bytes); }
#else
static void forbid(const void *begin, size_t bytes) { (void)begin, (void)bytes; }
static void allow(const void *begin, size_t bytes) { (void)begin, (void)bytes; }
#endif

/* Reserve bytes of the workspace, with a gap of `ALIGNMENT` at least behind them, and return where they begin. */
static uint8_t *reserve(uint8_t *memory, size_t *used, size_t bytes) {
    const size_t begin = *used;
    *used = (begin + bytes + 2 * ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    if (!memory) return NULL;
    allow(memory + begin, bytes);
    return memory + begin;
}

static Mask reserve_mask(uint8_t *memory, size_t *used, int32_t width, int32_t height) {
    const ptrdiff_t stride = ((ptrdiff_t)width + BITS - 1) / BITS * WORD_BYTES + WORD_BYTES;
    return (Mask){reserve(memory, used, (size_t)stride * (size_t)(height + 2) + WORD_BYTES), width, height, stride};
}

/* Lay out the workspace in `memory`, and return the bytes used. Without memory only the bytes are counted. */
static size_t lay_out(uint8_t *memory, int32_t width, int32_t height, Workspace *work) {
    const size_t pixels = (size_t)width * (size_t)height;
    size_t used = 0;
    work->tile = (Tile *)(void *)reserve(memory, &used, sizeof(Tile));
    work->column = reserve(memory, &used, (size_t)width / BITS_PER_BYTE + 3);
    work->dark = reserve_mask(memory, &used, width, height);
    work->eroded = reserve_mask(memory, &used, width, height);
    work->runs = (Run *)(void *)reserve(memory, &used, 2 * (size_t)width * sizeof(Run));
    /* A run without a dark neighbour above begins a region: at most every second pixel of every second row. */
    work->regions = (Region *)(void *)reserve(memory, &used, (pixels / 4 + (size_t)width) * sizeof(Region));
    work->max_points = (ptrdiff_t)(4 * pixels);
    work->points = (Point *)(void *)reserve(memory, &used, 4 * pixels * sizeof(Point));
    return used + ALIGNMENT;
}

/* Return the bytes of the workspace for an image, or 0 if the size is invalid. Most of it is rarely written. */
size_t search_workspace_bytes(int32_t width, int32_t height) {
    Workspace work;
    return valid_size(width, height) ? lay_out(NULL, width, height, &work) : 0;
}

static void clear_border(const Mask *mask) {
    memset(mask->bytes, 0, (size_t)mask->stride);
    for (int32_t y = 0; y < mask->height; y++) memset(mask_row(mask, y) - WORD_BYTES, 0, WORD_BYTES);
    memset(mask_row(mask, mask->height) - WORD_BYTES, 0, (size_t)mask->stride + WORD_BYTES);
}

static void begin(uint8_t *workspace, size_t workspace_bytes, int32_t width, int32_t height, Workspace *work) {
    forbid(workspace, workspace_bytes);
    lay_out(workspace + (ALIGNMENT - (uintptr_t)workspace % ALIGNMENT) % ALIGNMENT, width, height, work);
    clear_border(&work->dark);
    clear_border(&work->eroded);
}

/* Check the arguments, lay out the workspace, and threshold the image within its places. */
static int prepare(const uint8_t *image, const uint8_t *places, int32_t width, int32_t height,
                   const SearchParameters *parameters, uint8_t *workspace, size_t workspace_bytes, Workspace *work) {
    if (!valid_size(width, height) || workspace_bytes < search_workspace_bytes(width, height)) return INVALID_SIZE;
    if (!image || !places || !parameters || !workspace) return INVALID_PARAMETERS;
    if (parameters->first_erosions < 0 || parameters->last_erosions > 8 || parameters->darker < 0 ||
        parameters->darker > 255 || parameters->enlargement < 1 || parameters->enlargement > 2)
        return INVALID_PARAMETERS;
    if (width % (2 * parameters->enlargement) || height % (2 * parameters->enlargement)) return INVALID_SIZE;
    begin(workspace, workspace_bytes, width, height, work);
    return threshold(image, places, width, height, parameters, work);
}

/* Return the number of points of a region's boundary up to which it may be compact and large enough, or 0 if it is neither.
 *
 * The area within a boundary is at most that of its bounding box and its pixels', and limits its length. A boundary leads
 * from one side of the box to the other and back. */
static double longest_boundary(const Region *region, const SearchParameters *parameters) {
    const int32_t wide = region->right - region->left, high = region->bottom - region->top;
    const double box = (double)wide * high, filled = (double)region->filled, most = box < filled ? box : filled;
    const double longest = sqrt(most / parameters->min_compactness);
    return most > parameters->min_area_px2 && longest >= 2.0 * (wide > high ? wide : high) ? longest : 0.0;
}

/* Append the quadrilaterals of a mask. Return their new number, or an error. */
static int32_t append_quads(const Mask *mask, double growth_px, const SearchParameters *parameters, Workspace *work,
                            double *corners, int32_t *first_columns, int32_t found, int32_t max_quads) {
    const int32_t count = find_regions(mask, work);
    for (int32_t label = 0; label < count; label++) {
        const Region *region = work->regions + label;
        if (region->parent != label) continue;
        const double longest = longest_boundary(region, parameters), room = (double)work->max_points;
        Boundary boundary;
        if (longest == 0 || !trace(mask, region, (ptrdiff_t)(longest < room ? longest : room), work, &boundary)) continue;
        if (boundary.count < parameters->min_points) continue;
        const double area = enclosed_area(boundary), around = boundary.count;
        if (!(area > parameters->min_area_px2 && area > parameters->min_compactness * around * around)) continue;
        if (found >= max_quads) return TOO_MANY_RESULTS;
        first_columns[found] = region->first_x;
        found += fit_quad(boundary, area, growth_px, parameters, corners + 8 * (ptrdiff_t)found);
    }
    return found;
}

/* Find the dark quadrilaterals of an image, after each number of erosions from `first_erosions` to `last_erosions`.
 *
 * Width and height are those after the enlargement. `places` is a plane of half the size of the image as it is given, 255
 * where it is searched. The result is the number of quadrilaterals or
 * an error: corners (N, 4, 2), clockwise, px, and the column (N,) of the first pixel of each region.
 */
int32_t search_quads(const uint8_t *image, const uint8_t *places, int32_t width, int32_t height,
                     const SearchParameters *parameters, uint8_t *workspace, size_t workspace_bytes,
                     double *corners, int32_t *first_columns, int32_t max_quads) {
    Workspace work;
    const int failed = prepare(image, places, width, height, parameters, workspace, workspace_bytes, &work);
    if (failed) return failed;
    Mask *dark = &work.dark, *eroded = &work.eroded;
    int32_t found = 0;
    for (int32_t erosions = 0; found >= 0 && erosions <= parameters->last_erosions; erosions++) {
        if (erosions > 0) {
            erode(dark, eroded, work.column);
            Mask *swap = dark;
            dark = eroded;
            eroded = swap;
        }
        const double growth_px = parameters->growth_px + erosions * parameters->eroded_px;
        if (erosions >= parameters->first_erosions)
            found = append_quads(dark, growth_px, parameters, &work, corners, first_columns, found, max_quads);
    }
    return found;
}

/* Find the outer boundaries of large regions that are darker than the mean of their surroundings, a window of 21 px.
 *
 * Regions are at least min_side_px wide and high. The result is their number or an error: the points of all boundaries,
 * one after the other, and their numbers, counts (N,). There is room for max_points and max_regions.
 */
int32_t search_boundaries(const uint8_t *image, int32_t width, int32_t height, int32_t darker, int32_t min_side_px,
                          uint8_t *workspace, size_t workspace_bytes, Point *points, int64_t max_points,
                          int32_t *counts, int32_t max_regions) {
    Workspace work;
    int32_t found = 0;
    if (!valid_size(width, height) || workspace_bytes < search_workspace_bytes(width, height)) return INVALID_SIZE;
    if (!image || !workspace || darker < 0 || darker > 255) return INVALID_PARAMETERS;
    begin(workspace, workspace_bytes, width, height, &work);
    threshold_plain(image, width, height, darker, &work);
    const int32_t count = find_regions(&work.dark, &work);
    for (int32_t label = 0; label < count; label++) {
        const Region *region = work.regions + label;
        const int32_t wide = region->right - region->left + 1, high = region->bottom - region->top + 1;
        if (region->parent != label || wide < min_side_px || high < min_side_px) continue;
        Boundary boundary;
        if (!trace(&work.dark, region, work.max_points, &work, &boundary)) return TOO_MANY_RESULTS;
        if (boundary.count > max_points || found >= max_regions) return TOO_MANY_RESULTS;
        memcpy(points, boundary.points, (size_t)boundary.count * sizeof *points);
        points += boundary.count;
        max_points -= boundary.count;
        counts[found++] = boundary.count;
    }
    return found;
}
