/* Search for dark quadrilaterals in a grey image.
 *
 * search_quads() runs these steps on one image, which may be a mosaic of places:
 *   1. means.c    adaptive threshold by running box sums, and erosion of the dark pixels
 *   2. regions.c  horizontal runs of dark pixels, joined to regions; the outer boundary of a region
 *   3. quads.c    four corner points on a boundary, a line through each side, their intersections
 * search_boundaries() uses steps 1 and 2 alone. block_means() in resize.c shrinks an image,
 * stretch() in stretch.c prepares it for the search of faint markers,
 * sample_squares() in sampling.c reads what is within quadrilaterals, decode_cells() in decode.c finds the markers that
 * they resemble, and fit_edges() in edges.c refines their corners.
 *
 * Coordinates: x is the column, y the row (downwards). Planes are row-major. No function allocates memory: the caller
 * passes one workspace, whose size search_workspace_bytes() returns. The time is proportional to the number of pixels.
 */
#ifndef SKYHERD_SEARCH_H
#define SKYHERD_SEARCH_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "words of a mask are read from its bytes");

enum { MAX_SIDE_PX = 1 << 20, MAX_PIXELS = 1 << 28, DARK = 255, BITS = 64, BITS_PER_BYTE = 8, WORD_BYTES = 8 };

/* Largest window of a mean, px. Rows of the image, of its means and of the sharpened image that are kept: powers of two, more
 * than the windows that read them are high. */
enum { LARGE_WINDOW_PX = 21, RING_ROWS = 8, SHARP_ROWS = 32 };

/* Columns that are thresholded at a time. Loops take whole steps, and read less than LARGE_WINDOW_PX beyond them. */
enum { STRIP_PX = 512, STEP_PX = 32, TILE_COLUMNS = STRIP_PX + 3 * STEP_PX };

/* Negative results of the public functions. */
enum { INVALID_SIZE = -1, INVALID_PARAMETERS = -2, TOO_MANY_RESULTS = -3 };

/* Parameters of the search; vision/search/ states the reason of each value. */
typedef struct {
    double growth_px, eroded_px;           /* outward shift of the sides, and its increase with each erosion */
    double min_area_px2, min_compactness;  /* limits of the area within a boundary */
    double rounded_share, side_end_weight; /* ends of a side that the line ignores, and their weight */
    double min_length_px, min_crossing;    /* smallest divisor of a direction; smallest sine of a corner */
    double min_side_px, max_side_ratio, max_area_mismatch;
    int32_t darker, min_points;
    int32_t smoothing_px, sharpening_px, small_window_px, large_window_px;
    int32_t first_erosions, last_erosions; /* numbers of erosions after which regions are searched */
    int32_t enlargement;                   /* of the image before it is searched, 1 or 2 */
} SearchParameters;

/* Parameters of the refinement by edges; vision/search/edges.py states the reason of each value. */
typedef struct {
    double end_share;                               /* share of a side without normals at either end */
    double reach_cells, min_reach_px, max_reach_px; /* length of a normal on either side, with its limits */
    double tukey_sigmas, min_spread_px, median_per_sigma, min_inlier_weight;
    double min_crossing, min_divisor;
    int32_t normals, steps, rounds, reweightings; /* steps on either side of a line */
} EdgeParameters;

typedef struct { int32_t x, y; } Point;

/* Outer boundary of a region: `count` points, anticlockwise in the image, from its first pixel in row order. */
typedef struct { const Point *points; int32_t count; } Boundary;

/* A binary image: bit x % 8 of byte x / 8 of a row is 1 where pixel x is dark. It has an eighth of an image's bytes, so that
 * it stays in the processor's cache. Rows are filled up with zeros to whole words, and begin behind a word of zeros; there
 * is a row of zeros above the first one and one below the last. So pixels beside the image are never dark. */
typedef struct { uint8_t *bytes; int32_t width, height; ptrdiff_t stride; } Mask;

/* Row `from <= x < to` of dark pixels, and its region. */
typedef struct { int32_t from, to, y, label; } Run;

/* Bounding box of a region and its first pixel in row order; `parent` is the label of a region joined with it.
 *
 * `filled` is at least the number of pixels within its outer boundary: what lies between two runs of a row that are joined by
 * rows above may be a hole, and nothing else can be. `row_end` is where the runs in the row `bottom` end so far. */
typedef struct { int32_t parent, left, right, top, bottom, first_x, row_end; int64_t filled; } Region;

/* Rings of rows of a strip, and sums over the rows of each box: two of the unsharp mask, one after the other, that of the
 * noise filter, and both windows. Row y of a ring has the index y modulo its rows. */
typedef struct {
    uint16_t grey[RING_ROWS][TILE_COLUMNS], once[RING_ROWS][TILE_COLUMNS], sharp[SHARP_ROWS][TILE_COLUMNS];
    uint16_t once_sums[TILE_COLUMNS], twice_sums[TILE_COLUMNS], smooth_sums[TILE_COLUMNS];
    uint16_t small_sums[TILE_COLUMNS], large_sums[TILE_COLUMNS], fives[TILE_COLUMNS];
    uint8_t dark[STRIP_PX], places[STRIP_PX / 2];
} Tile;

/* Rows, planes and lists of one search. */
typedef struct {
    Tile *tile;
    uint8_t *column; /* a row of the erosion */
    Mask dark, eroded;
    Run *runs;
    Region *regions;
    Point *points;
    ptrdiff_t max_points;
} Workspace;

static inline uint8_t *mask_row(const Mask *mask, int32_t y) {
    return mask->bytes + (y + 1) * mask->stride + WORD_BYTES;
}

/* Return 64 pixels of a row from a multiple of 64 on: bit i is pixel i. */
static inline uint64_t word_at(const uint8_t *row, int32_t x) {
    uint64_t word;
    memcpy(&word, row + x / BITS_PER_BYTE, sizeof word);
    return word;
}

/* means.c */
int threshold(const uint8_t *image, const uint8_t *places, int32_t width, int32_t height,
              const SearchParameters *parameters, Workspace *work);
void threshold_plain(const uint8_t *image, int32_t width, int32_t height, int32_t darker, Workspace *work);
void erode(const Mask *mask, const Mask *eroded, uint8_t *scratch);

/* regions.c */
int32_t find_regions(const Mask *mask, Workspace *work);
int trace(const Mask *mask, const Region *region, ptrdiff_t max_points, Workspace *work, Boundary *boundary);

/* quads.c */
double enclosed_area(Boundary boundary);
int fit_quad(Boundary boundary, double area, double growth_px, const SearchParameters *parameters,
             double corners[8]);

/* The library's functions, called from Python. */
size_t search_workspace_bytes(int32_t width, int32_t height);
int32_t search_quads(const uint8_t *image, const uint8_t *places, int32_t width, int32_t height,
                     const SearchParameters *parameters, uint8_t *workspace, size_t workspace_bytes,
                     double *corners, int32_t *first_columns, int32_t max_quads);
int32_t search_boundaries(const uint8_t *image, int32_t width, int32_t height, int32_t darker, int32_t min_side_px,
                          uint8_t *workspace, size_t workspace_bytes, Point *points, int64_t max_points,
                          int32_t *counts, int32_t max_regions);
/* Codes under one blur, standardised: columns (cells, stride), and mean and standard deviation of the darkness of each; `least`
 * likenesses are explained at decode_cells(). */
typedef struct { const float *columns; const double *means, *deviations; int64_t count, stride; double least; } CodeTable;

/* Limits of the decoding; decode.py says why. */
typedef struct { double min_deviation, min_white; } DecodeConstants;

/* The code that a row of cells resembles most: likeness, print contrast, and standard deviation of the cells. */
typedef struct { double likeness, print_contrast, deviation; int64_t code; } Decoded;

int32_t block_means(const uint8_t *image, int32_t width, int32_t height, int32_t side, uint16_t *sums, uint8_t *means);
int32_t sample_squares(const uint8_t *image, int32_t width, int32_t height, const double *corners, int64_t count,
                       const double *at, int32_t side, int32_t fine, float *levels);
int32_t decode_cells(const float *cells, int64_t rows, int32_t cells_count, const int32_t *table_of_row,
                     const CodeTable *tables, int32_t table_count, const DecodeConstants *constants, Decoded *decoded);
int32_t code_products(const float *samples, int64_t rows, int32_t cells, const float *columns, int64_t count, int64_t stride,
                      float *products);
int32_t fit_edges(const uint8_t *image, int32_t width, int32_t height, int64_t count, int32_t cells,
                  const EdgeParameters *given, double *corners, double *spreads, double *supports, double *rises);
int32_t stretch(const uint8_t *image, int32_t width, int32_t height, const float *gains, const float *shifts,
                const uint8_t *is_sharp, int32_t columns, int32_t rows, float *memory, uint8_t *stretched);

#endif
