/* Quadrilateral of a boundary: four corner points, a line through each side, and their intersections. */
#include "search.h"

#include <math.h>

typedef struct { double x, y; } Vector;
typedef struct { Vector mean, along; } Line;

static Vector plus(Vector a, double factor, Vector b) { return (Vector){a.x + factor * b.x, a.y + factor * b.y}; }
static Vector minus(Vector a, Vector b) { return (Vector){a.x - b.x, a.y - b.y}; }
static double cross(Vector a, Vector b) { return a.x * b.y - a.y * b.x; }
static double length(Vector a) { return sqrt(a.x * a.x + a.y * a.y); }
static Vector vector(Point a) { return (Vector){a.x, a.y}; }

/* Return the area within a boundary, px²: -1/2 Σ p x p', positive since boundaries run anticlockwise (y is down). */
double enclosed_area(Boundary boundary) {
    int64_t twice = 0;
    Point before = boundary.points[boundary.count - 1];
    for (int32_t i = 0; i < boundary.count; i++) {
        const Point at = boundary.points[i];
        twice += (int64_t)before.x * at.y - (int64_t)before.y * at.x;
        before = at;
    }
    return -(double)twice / 2;
}

/* Return the index of the point farthest from `centre / share`, the first of equals. The values are exact. */
static int32_t farthest(Boundary boundary, Vector centre, double share) {
    int32_t found = 0;
    double largest = -1.0;
    for (int32_t i = 0; i < boundary.count; i++) {
        const double x = share * boundary.points[i].x - centre.x, y = share * boundary.points[i].y - centre.y;
        const double squared = x * x + y * y;
        if (squared > largest) largest = squared, found = i;
    }
    return found;
}

/* Select four corner points, in ascending order.
 *
 * One is farthest from the boundary's mean, and the opposite one is farthest from it. The other two are farthest from
 * the diagonal between them, on either side. */
static void corner_points(Boundary boundary, int32_t corners[4]) {
    Vector sum = {0, 0};
    for (int32_t i = 0; i < boundary.count; i++) sum = plus(sum, 1.0, vector(boundary.points[i]));
    const int32_t first = farthest(boundary, sum, boundary.count);
    const Vector origin = vector(boundary.points[first]);
    const int32_t third = farthest(boundary, origin, 1.0);
    const Vector diagonal = minus(vector(boundary.points[third]), origin);
    int32_t second = 0, fourth = 0;
    double largest = -INFINITY, smallest = INFINITY;
    for (int32_t i = 0; i < boundary.count; i++) {
        const double off = cross(diagonal, minus(vector(boundary.points[i]), origin));
        if (off > largest) largest = off, second = i;
        if (off < smallest) smallest = off, fourth = i;
    }
    const int32_t found[4] = {first, second, third, fourth};
    for (int i = 0; i < 4; i++) { /* insertion sort */
        int k = i;
        for (; k > 0 && corners[k - 1] > found[i]; k--) corners[k] = corners[k - 1];
        corners[k] = found[i];
    }
}

/* Return the direction of Σ w (p - mean)², half of its angle: the complex square root of (re, im), without length. */
static Vector half_angle(double re, double im, double min_length) {
    const double magnitude = sqrt(re * re + im * im);
    Vector root;
    if (re >= 0) {
        root.x = sqrt((magnitude + re) / 2);
        root.y = root.x > 0 ? im / (2 * root.x) : 0.0;
    } else {
        root.y = im < 0 ? -sqrt((magnitude - re) / 2) : sqrt((magnitude - re) / 2);
        root.x = im / (2 * root.y);
    }
    const double size = length(root), divisor = size > min_length ? size : min_length;
    return (Vector){root.x / divisor, root.y / divisor};
}

/* Fit a line by weighted total least squares to `count` points of the ring from index `begin`. */
static Line fit_line(Boundary boundary, int32_t begin, int32_t count, const SearchParameters *parameters) {
    const double middle_half = 0.5 - parameters->rounded_share;
    const Vector origin = vector(boundary.points[begin]);
    Vector mean = {0, 0};
    double total = 0, re = 0, im = 0;
    for (int pass = 0; pass < 2; pass++) { /* first the mean, then the second moments about it */
        for (int32_t i = 0, at = begin; i < count; i++, at = at + 1 < boundary.count ? at + 1 : 0) {
            const int inner = fabs((double)i / count - 0.5) <= middle_half;
            const double weight = inner + parameters->side_end_weight;
            const Vector p = minus(minus(vector(boundary.points[at]), origin), mean);
            if (pass == 0) total += weight, re += weight * p.x, im += weight * p.y;
            else re += weight * (p.x * p.x - p.y * p.y), im += 2 * weight * p.x * p.y;
        }
        if (pass == 0) mean = (Vector){re / total, im / total}, re = 0, im = 0;
    }
    const int32_t end = (begin + count) % boundary.count;
    const Vector chord = minus(vector(boundary.points[end]), origin);
    Vector along = half_angle(re, im, parameters->min_length_px);
    if (along.x * chord.x + along.y * chord.y < 0) along = (Vector){-along.x, -along.y};
    return (Line){plus(mean, 1.0, origin), along};
}

/* Return the intersection of two lines; of nearly parallel ones a point of the first. */
static Vector intersection(Line first, Line second, double min_crossing) {
    const double crossing = cross(first.along, second.along);
    if (fabs(crossing) < min_crossing) return first.mean;
    return plus(first.mean, cross(minus(second.mean, first.mean), second.along) / crossing, first.along);
}

/* Return whether clockwise corners form a convex quadrilateral of valid sides and area. */
static int is_quad(const Vector corners[4], double area, double growth_px, const SearchParameters *parameters) {
    Vector sides[4];
    double lengths[4], shortest = INFINITY, longest = 0, around = 0;
    for (int i = 0; i < 4; i++) {
        sides[i] = minus(corners[(i + 1) % 4], corners[i]);
        lengths[i] = length(sides[i]);
        shortest = lengths[i] < shortest ? lengths[i] : shortest;
        longest = lengths[i] > longest ? lengths[i] : longest;
        around += lengths[i];
    }
    for (int i = 0; i < 4; i++) {
        const int next = (i + 1) % 4;
        if (!(cross(sides[i], sides[next]) > parameters->min_crossing * lengths[i] * lengths[next])) return 0;
    }
    const double inside = cross(minus(corners[2], corners[0]), minus(corners[3], corners[1])) / 2;
    const double grown = area + growth_px * around;
    return shortest >= parameters->min_side_px && longest <= parameters->max_side_ratio * shortest &&
           fabs(inside - grown) <= parameters->max_area_mismatch * inside;
}

/* Fit a quadrilateral to a boundary. Write its corners, clockwise, and return 1, or return 0 if it has none. */
int fit_quad(Boundary boundary, double area, double growth_px, const SearchParameters *parameters,
             double corners[8]) {
    int32_t at[4];
    corner_points(boundary, at);
    Line lines[4];
    for (int side = 0; side < 4; side++) {
        const int32_t end = side < 3 ? at[side + 1] : at[0] + boundary.count;
        if (end - at[side] < 2) return 0; /* the direction of a single point is undefined */
        lines[side] = fit_line(boundary, at[side], end - at[side], parameters);
        const Vector outwards = {-lines[side].along.y, lines[side].along.x};
        lines[side].mean = plus(lines[side].mean, growth_px, outwards);
    }
    Vector met[4];
    for (int side = 0; side < 4; side++)
        met[3 - side] = intersection(lines[(side + 3) % 4], lines[side], parameters->min_crossing);
    if (!is_quad(met, area, growth_px, parameters)) return 0;
    for (int i = 0; i < 4; i++) corners[2 * i] = met[i].x, corners[2 * i + 1] = met[i].y;
    return 1;
}
