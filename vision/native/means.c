/* Adaptive threshold by running box sums, and erosion. Means equal cv2.blur with its default border. */
#include "search.h"

#include <string.h>

/* Windows of the threshold, px, and how far its pixels are from the ones that they depend on. */
enum {
    SMOOTHING_PX = 3,
    SHARPENING_PX = 5,
    SMALL_WINDOW_PX = 9,
    LARGE_REACH_PX = LARGE_WINDOW_PX / 2,
    SHARP_REACH_PX = LARGE_REACH_PX + 2 * (SHARPENING_PX / 2),
};

/* Rows ahead that are loaded into the cache. Chosen: those of a microsecond, more than memory takes. */
enum { CACHE_LINE_BYTES = 64, ROWS_AHEAD = 8 };

/* Grey levels that are above the range, so that no mean reaches them. */
enum { ABOVE_ALL = 256 };

/* Return the index of `at` within 0..length-1, mirrored at the ends without repeating them. */
static int32_t mirrored(int32_t at, int32_t length) {
    const int32_t last = length - 1, forward = at < 0 ? -at : at;
    if (forward <= last) return forward;
    if (forward <= 2 * last) return 2 * last - forward;
    if (last == 0) return 0;
    const int32_t rest = forward % (2 * last); /* windows wider than the image are mirrored several times */
    return rest <= last ? rest : 2 * last - rest;
}

/* Width and height of an image, which is that of the pixels or, with an enlargement of 2, twice as large. */
typedef struct { const uint8_t *pixels; int32_t width, height, enlargement; } Image;

static const uint8_t *line_at(const Image *image, int32_t line) {
    return image->pixels + (ptrdiff_t)line * (image->width / image->enlargement);
}

/* Load the pixels of a line that is read soon into the cache: processors expect one line after the other, not a strip. */
static void prefetch_line(const Image *image, int32_t line, int32_t from, int32_t to) {
    if (line < 0 || line >= image->height / image->enlargement) return;
    for (int32_t x = from; x < to; x += CACHE_LINE_BYTES) __builtin_prefetch(line_at(image, line) + x);
}

/* Return a quarter of the way from one line to another one, from four times their levels. Both parts are rounded down before
 * they are added. */
static inline uint16_t between(uint16_t near, uint16_t far) {
    return (uint16_t)((uint16_t)((far >> 2) + ((uint16_t)(3 * near) >> 2) + 2) >> 2);
}

/* Write the pixel at x of a line at twice the size. `left` and `right` are its neighbours, which borders repeat. */
static inline void enlarge_pixel(const uint8_t *near, const uint8_t *far, int32_t left, int32_t x, int32_t right,
                                 uint16_t *two) {
    two[0] = between((uint16_t)(3 * near[x] + near[left]), (uint16_t)(3 * far[x] + far[left]));
    two[1] = between((uint16_t)(3 * near[x] + near[right]), (uint16_t)(3 * far[x] + far[right]));
}

/* Write pixels `from <= x < to` of row y at twice the size by bilinear interpolation, as cv2.resize on x86-64. */
static void enlarge_row(const Image *image, int32_t y, int32_t from, int32_t to, uint16_t *restrict row) {
    const int32_t last_line = image->height / 2 - 1, last = image->width / 2 - 1, line = y / 2;
    const int32_t beside = y % 2 ? line + 1 : line - 1, other = beside < 0 ? 0 : beside > last_line ? last_line : beside;
    const uint8_t *restrict near = line_at(image, line), *restrict far = line_at(image, other);
    const int32_t begin = from / 2 > 0 ? from / 2 : 1, end = to / 2 < last ? to / 2 : last;
    if (from == 0) enlarge_pixel(near, far, 0, 0, last > 0, row);
    for (int32_t x = begin; x < end; x++) enlarge_pixel(near, far, x - 1, x, x + 1, row + (2 * x - from));
    if (last > 0 && to / 2 > last) enlarge_pixel(near, far, last - 1, last, last, row + (2 * last - from));
}

/* Read `count` pixels of row y from column `first` on; both may be beyond the border, where the image is mirrored.
 *
 * `first` and `count` are even, and the columns include those that are mirrored. */
static void read_row(const Image *image, int32_t y, int32_t first, int32_t count, uint16_t *restrict row) {
    const int32_t inside = mirrored(y, image->height), from = first < 0 ? 0 : first;
    const int32_t to = first + count < image->width ? first + count : image->width, twice = image->enlargement;
    prefetch_line(image, inside / twice + ROWS_AHEAD, from / twice, to / twice);
    if (twice == 2) {
        enlarge_row(image, inside, from, to, row + (from - first));
    } else {
        const uint8_t *restrict line = line_at(image, inside);
        for (int32_t x = from; x < to; x++) row[x - first] = line[x];
    }
    for (int32_t x = first; x < from; x++) row[x - first] = row[mirrored(x, image->width) - first];
    for (int32_t x = to; x < first + count; x++) row[x - first] = row[mirrored(x, image->width) - first];
}

/* Move sums over the rows of a window down by a row. */
static void slide(uint16_t *restrict sums, const uint16_t *restrict added, const uint16_t *restrict removed, int32_t count) {
    for (int32_t x = 0; x < count; x++) sums[x] = (uint16_t)(sums[x] + added[x] - removed[x]);
}

/* Return the sum of `window_px` neighbours; the callers pass a constant, so that it is unrolled. */
static inline __attribute__((always_inline)) uint16_t sum_of(const uint16_t *first, int32_t window_px) {
    uint16_t sum = first[0];
    for (int32_t k = 1; k < window_px; k++) sum = (uint16_t)(sum + first[k]);
    return sum;
}

/* Return the mean of a small window: floor((sum + area / 2) / area), by a multiplication with 2^(16 + shift) / area, rounded
 * up. It is exact for sums up to 255 * area: its relative error is below 1 / (255 * area + area / 2). */
static inline __attribute__((always_inline)) uint16_t mean_of(const uint16_t *first, int32_t window_px, int32_t shift) {
    const uint32_t area = (uint32_t)(window_px * window_px), factor = ((1u << (16 + shift)) + area - 1) / area;
    const uint16_t sum = (uint16_t)(sum_of(first, window_px) + area / 2);
    return (uint16_t)((uint16_t)((sum * factor) >> 16) >> shift);
}

/* Write the means over a box of the unsharp mask, from sums over its rows. */
static void mean_row(const uint16_t *restrict sums, uint16_t *restrict means, int32_t count) {
    for (int32_t x = 0; x < count; x++) means[x] = mean_of(sums + x, SHARPENING_PX, 4);
}

/* Sharpen by an unsharp mask: twice the smooth row less the wide mean, within 0 to 255. Both come from sums over rows. */
static void sharpen_row(const uint16_t *restrict smooth_sums, const uint16_t *restrict wide_sums, uint16_t *restrict sharp,
                        int32_t count) {
    for (int32_t x = 0; x < count; x++) {
        const uint16_t smooth = mean_of(smooth_sums + x, SMOOTHING_PX, 3), wide = mean_of(wide_sums + x, SHARPENING_PX, 4);
        int16_t value = (int16_t)(2 * smooth - wide);
        value = value < 0 ? 0 : value;
        sharp[x] = (uint16_t)(value > 255 ? 255 : value);
    }
}

/* Write sums over five neighbours. */
static void sum_fives(const uint16_t *restrict sums, uint16_t *restrict fives, int32_t count) {
    for (int32_t x = 0; x < count; x++) fives[x] = sum_of(sums + x, 5);
}

/* Return whether the mean over the large window is at least `least` grey levels: sum + area / 2 >= least * area.
 *
 * The sum has 17 bits. It is that of 10 columns and of 11, whose half is floor(a / 2 + b / 2), and a bit that is left. */
static inline uint16_t is_brighter(const uint16_t *fives, const uint16_t *sums, uint16_t least) {
    enum { AREA = LARGE_WINDOW_PX * LARGE_WINDOW_PX };
    const uint16_t a = (uint16_t)(fives[0] + fives[5]), b = (uint16_t)(fives[10] + fives[15] + sums[20] + AREA / 2);
    const uint16_t half = (uint16_t)((a & b) + ((uint16_t)(a ^ b) >> 1)), odd = (a ^ b) & 1;
    return half >= (uint16_t)(AREA / 2 * least + ((uint16_t)(least + 1 - odd) >> 1));
}

/* Write as 255 the pixels of a row that are darker than the mean of either window, and the others as 0.
 *
 * small and large are sums over the rows of the windows, from the first column of the first pixel's window on. */
static void compare(const uint16_t *restrict small, const uint16_t *restrict large, const uint16_t *restrict fives,
                    const uint16_t *restrict sharp, uint8_t *restrict dark, int32_t count, int32_t darker) {
    enum { AREA = SMALL_WINDOW_PX * SMALL_WINDOW_PX };
    for (int32_t x = 0; x < count; x++) {
        uint16_t least = (uint16_t)(sharp[x] + darker + 1);
        least = least < ABOVE_ALL ? least : ABOVE_ALL;
        const uint16_t sum = (uint16_t)(sum_of(small + x, SMALL_WINDOW_PX) + AREA / 2);
        dark[x] = (sum >= (uint16_t)(AREA * least)) | is_brighter(fives + x, large + x, least) ? DARK : 0;
    }
}

/* Write as 255 the pixels of a row that are darker than the mean of the large window, and the others as 0. */
static void compare_large(const uint16_t *restrict large, const uint16_t *restrict fives, const uint16_t *restrict grey,
                          uint8_t *restrict dark, int32_t count, int32_t darker) {
    for (int32_t x = 0; x < count; x++) {
        uint16_t least = (uint16_t)(grey[x] + darker + 1);
        least = least < ABOVE_ALL ? least : ABOVE_ALL;
        dark[x] = is_brighter(fives + x, large + x, least) ? DARK : 0;
    }
}

/* Clear the pixels outside of the places, `kept`, a row of half the size. */
static void keep_places(uint8_t *restrict row, const uint8_t *restrict kept, int32_t count) {
    for (int32_t x = 0; x < count / 2; x++) {
        row[2 * x] &= kept[x];
        row[2 * x + 1] &= kept[x];
    }
}

/* Write `count` pixels, 0 or 255, as bits; what is beyond them up to a multiple of 64 is to be 0. */
static void pack(const uint8_t *restrict pixels, uint8_t *restrict bits, int32_t count) {
    for (int32_t byte = 0; byte < count / BITS_PER_BYTE; byte++) {
        uint64_t eight;
        memcpy(&eight, pixels + BITS_PER_BYTE * byte, sizeof eight);
        eight &= 0x8040201008040201u; /* bit i of byte i */
        eight |= eight >> 32;
        eight |= eight >> 16;
        eight |= eight >> 8;
        bits[byte] = (uint8_t)eight;
    }
}

/* Return whether 64 pixels of a row from x on have a place. `kept` is a row of the places, of half the size. */
static int has_place(const uint8_t *kept, int32_t x, int32_t width) {
    const int32_t end = x + BITS < width ? x + BITS : width;
    uint8_t any = 0;
    for (int32_t i = x / 2; i < end / 2; i++) any |= kept[i];
    return any;
}

/* Pixels `from <= x < to` of a row; `from` is a multiple of 64, and so is `to` unless it is the end of the row. */
typedef struct { int32_t from, to; } Segment;

/* Return the first segment from x on that has places all along; it is empty at the end, `width`. */
static Segment next_segment(const uint8_t *kept, int32_t x, int32_t width) {
    while (x < width && !has_place(kept, x, width)) x += BITS;
    Segment segment = {x < width ? x : width, x};
    while (segment.to < width && has_place(kept, segment.to, width)) segment.to += BITS;
    segment.to = segment.to < width ? segment.to : width;
    return segment;
}

/* What the threshold of one image reads and writes; without places all pixels count. */
typedef struct { Image image; const uint8_t *places; int32_t darker; Workspace *work; } Threshold;

/* Columns `left <= x < right` of an image, at most STRIP_PX of them. */
typedef struct { int32_t left, right; } Strip;

static int32_t rounded_up(int32_t count) { return (count + STEP_PX - 1) / STEP_PX * STEP_PX; }

/* Return the places of a strip in row y, of half the size, from the strip's first column on. */
static const uint8_t *places_of_row(const Threshold *all, Strip strip, int32_t y) {
    const int32_t twice = all->image.enlargement;
    const uint8_t *given = all->places + (ptrdiff_t)(y / 2 / twice) * (all->image.width / 2 / twice) + strip.left / 2 / twice;
    if (twice == 1) return given;
    uint8_t *restrict places = all->work->tile->places;
    const int32_t count = (strip.right - strip.left) / 4;
    for (int32_t x = 0; x < count; x++) places[2 * x] = places[2 * x + 1] = given[x];
    return places;
}

/* Find the dark pixels of a segment of row y, after the sums over rows of both windows are about it.
 *
 * Columns of segments count from the strip's first one. `kept` are the places of the strip, or NULL. */
static void threshold_segment(const Threshold *all, Strip strip, Segment segment, const uint8_t *kept, int32_t y) {
    Tile *tile = all->work->tile;
    const int32_t first = segment.from, count = segment.to - segment.from, whole = rounded_up(count);
    const uint16_t *large = tile->large_sums + first, *small = tile->small_sums + first + LARGE_REACH_PX - SMALL_WINDOW_PX / 2;
    const uint16_t *sharp = tile->sharp[y & (SHARP_ROWS - 1)] + first + LARGE_REACH_PX;
    uint8_t *dark = tile->dark, *bits = mask_row(&all->work->dark, y) + (strip.left + first) / BITS_PER_BYTE;
    sum_fives(large, tile->fives, rounded_up(whole + LARGE_WINDOW_PX));
    if (kept) {
        compare(small, large, tile->fives, sharp, dark, whole, all->darker);
        keep_places(dark, kept + first / 2, count);
    } else {
        compare_large(large, tile->fives, sharp, dark, whole, all->darker);
    }
    memset(dark + count, 0, (size_t)(STRIP_PX - count));
    pack(dark, bits, (count + BITS - 1) / BITS * BITS);
}

/* Find the dark pixels of row y of a strip. */
static void threshold_row(const Threshold *all, Strip strip, int32_t y) {
    const int32_t width = strip.right - strip.left;
    if (!all->places) {
        threshold_segment(all, strip, (Segment){0, width}, NULL, y);
        return;
    }
    const uint8_t *kept = places_of_row(all, strip, y);
    Segment segment = next_segment(kept, 0, width);
    for (; segment.from < width; segment = next_segment(kept, segment.to, width))
        threshold_segment(all, strip, segment, kept, y);
}

/* Compute row y of the sharpened image, and the steps before it, from the row SHARP_REACH_PX - LARGE_REACH_PX below on.
 *
 * The rows are to be asked for one after the other. Rings of rows are cleared before the first one; a row that no step has
 * written counts as 0 and is not read when the sums are complete. */
static void sharp_row(const Threshold *all, Strip strip, int32_t first, int32_t y) {
    enum { HALF = SHARPENING_PX / 2, LAST = RING_ROWS - 1 };
    Tile *tile = all->work->tile;
    const int32_t count = rounded_up(strip.right - strip.left + 2 * SHARP_REACH_PX), below = y + 2 * HALF;
    read_row(&all->image, below, strip.left - SHARP_REACH_PX, count, tile->grey[below & LAST]);
    slide(tile->once_sums, tile->grey[below & LAST], tile->grey[(below - SHARPENING_PX) & LAST], count);
    const int32_t once = y + HALF, next = y + SMOOTHING_PX / 2;
    slide(tile->smooth_sums, tile->grey[next & LAST], tile->grey[(next - SMOOTHING_PX) & LAST], count);
    if (once < first - HALF) return;
    mean_row(tile->once_sums, tile->once[once & LAST], count);
    slide(tile->twice_sums, tile->once[once & LAST], tile->once[(once - SHARPENING_PX) & LAST], count);
    if (y < first) return;
    const uint16_t *smooth_sums = tile->smooth_sums + SHARP_REACH_PX - LARGE_REACH_PX - SMOOTHING_PX / 2;
    sharpen_row(smooth_sums, tile->twice_sums, tile->sharp[y & (SHARP_ROWS - 1)], count);
}

/* Find the dark pixels of rows `top <= y < bottom` of a strip. */
static void threshold_tile(const Threshold *all, Strip strip, int32_t top, int32_t bottom) {
    enum { LAST = SHARP_ROWS - 1 };
    Tile *tile = all->work->tile;
    memset(tile, 0, sizeof *tile);
    const int32_t first = top - LARGE_REACH_PX, end = bottom + LARGE_REACH_PX;
    const int32_t needed = strip.right - strip.left + 2 * LARGE_REACH_PX, count = rounded_up(needed);
    for (int32_t y = first - (all->places ? 4 * (SHARPENING_PX / 2) : 0); y < end; y++) {
        if (all->places) sharp_row(all, strip, first, y);
        else read_row(&all->image, y, strip.left - LARGE_REACH_PX, needed, tile->sharp[y & LAST]);
        if (y < first) continue;
        slide(tile->large_sums, tile->sharp[y & LAST], tile->sharp[(y - LARGE_WINDOW_PX) & LAST], count);
        const int32_t here = y - LARGE_REACH_PX, small = here + SMALL_WINDOW_PX / 2;
        if (all->places && small >= first)
            slide(tile->small_sums, tile->sharp[small & LAST], tile->sharp[(small - SMALL_WINDOW_PX) & LAST], count);
        if (here >= top) threshold_row(all, strip, here);
    }
}

/* Return the first row from y on where a strip has places, or has none if `wanted` is 0; `height` if there is no such row. */
static int32_t next_row(const Threshold *all, Strip strip, int32_t y, int wanted) {
    const int32_t height = all->image.height, width = strip.right - strip.left;
    while (y < height && (next_segment(places_of_row(all, strip, y), 0, width).from < width) != wanted) y += 2;
    return y < height ? y : height;
}

/* Find the dark pixels of a strip where it has places. Rows between them are computed too if that takes less time. */
static void threshold_strip(const Threshold *all, Strip strip) {
    const int32_t height = all->image.height;
    int32_t top = next_row(all, strip, 0, 1);
    while (top < height) {
        int32_t bottom = next_row(all, strip, top, 0), next = next_row(all, strip, bottom, 1);
        while (next < height && next < bottom + 2 * SHARP_REACH_PX) {
            bottom = next_row(all, strip, next, 0);
            next = next_row(all, strip, bottom, 1);
        }
        threshold_tile(all, strip, top, bottom);
        top = next;
    }
}

/* Find the dark pixels of an image, strip by strip, so that all rows at hand stay in the processor's first cache. */
static void threshold_strips(const Threshold *all) {
    const int32_t width = all->image.width, height = all->image.height;
    for (int32_t y = 0; y < height; y++) memset(mask_row(&all->work->dark, y), 0, (size_t)(all->work->dark.stride - WORD_BYTES));
    for (int32_t left = 0; left < width; left += STRIP_PX) {
        const Strip strip = {left, left + STRIP_PX < width ? left + STRIP_PX : width};
        if (all->places) threshold_strip(all, strip);
        else threshold_tile(all, strip, 0, height);
    }
}

/* Find the pixels of the sharpened image that are darker than the larger of two local means.
 *
 * `places` is a plane of half the size of what is given, 255 where pixels count. Width and height are those after the
 * enlargement. */
int threshold(const uint8_t *image, const uint8_t *places, int32_t width, int32_t height,
              const SearchParameters *parameters, Workspace *work) {
    if (parameters->smoothing_px != SMOOTHING_PX || parameters->sharpening_px != SHARPENING_PX ||
        parameters->small_window_px != SMALL_WINDOW_PX || parameters->large_window_px != LARGE_WINDOW_PX)
        return INVALID_PARAMETERS;
    threshold_strips(&(Threshold){{image, width, height, parameters->enlargement}, places, parameters->darker, work});
    return 0;
}

/* Find the pixels of an image that are darker than the mean of the large window. */
void threshold_plain(const uint8_t *image, int32_t width, int32_t height, int32_t darker, Workspace *work) {
    threshold_strips(&(Threshold){{image, width, height, 1}, NULL, darker, work});
}

/* Keep the pixels whose eight neighbours are all dark. Neighbours outside of the image count as dark. */
void erode(const Mask *mask, const Mask *eroded, uint8_t *scratch) {
    const int32_t last_y = mask->height - 1, left = mask->width % BITS_PER_BYTE;
    const ptrdiff_t bytes = mask->stride - WORD_BYTES, last = (mask->width - 1) / BITS_PER_BYTE;
    const uint8_t beyond = left ? (uint8_t)(DARK << left) : 0; /* bits of the last byte that are no pixels */
    uint8_t *column = scratch + 1;
    column[-1] = column[last + 1] = DARK;
    for (int32_t y = 0; y <= last_y; y++) {
        const uint8_t *above = mask_row(mask, y > 0 ? y - 1 : 0), *row = mask_row(mask, y);
        const uint8_t *below = mask_row(mask, y < last_y ? y + 1 : last_y);
        uint8_t *restrict kept = mask_row(eroded, y);
        for (ptrdiff_t i = 0; i <= last; i++) column[i] = above[i] & row[i] & below[i];
        column[last] |= beyond;
        for (ptrdiff_t i = 0; i <= last; i++)
            kept[i] = column[i] & (uint8_t)(column[i] << 1 | column[i - 1] >> 7) &
                      (uint8_t)(column[i] >> 1 | column[i + 1] << 7);
        kept[last] &= (uint8_t)~beyond;
        memset(kept + last + 1, 0, (size_t)(bytes - last - 1));
    }
}
