"""Perception by projection of the markers, exact or with the measured errors of a detector."""

from collections.abc import Sequence

import numpy as np

from skyherd.geometry import IntArray
from skyherd.markers.dictionary import card_side, headings_of_corners, sides_of_corners
from skyherd.messages import Detections, Quality, among
from skyherd.render import TeamImage, project_team
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World
from skyherd.vision import DetectorAccuracy


class ProjectedPerception(Perception):
    """Projection of every marker whose card is whole in view, exact or with errors of a detector.

    Args:
        side_m: side of the markers.
        dictionary: dictionary of the markers.
        accuracy: accuracy of a detector. Its recall determines independently for each marker and image
            whether the marker is missed. Its errors apply to positions, headings, sides and shapes. None for
            exact detections of all markers.
        rng: generator of misses and errors.
    """

    def __init__(
        self,
        side_m: float,
        dictionary: str,
        *,
        accuracy: DetectorAccuracy | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.side_m, self.dictionary, self.accuracy = side_m, dictionary, accuracy
        self.rng = rng or np.random.default_rng(0)

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """Project the markers into each unit's image."""
        views = [(world.cameras[unit], world.camera_pose(unit)) for unit in units]
        markers, card_side_m = world.markers, self.side_m * card_side(self.dictionary)
        clear = ~among(markers.ids, world.covered_ids)
        positions_m, headings_rad = markers.positions_m[clear], markers.headings_rad[clear]
        images = project_team(views, positions_m, headings_rad, self.side_m, card_side_m)
        return [
            self._sight(world, unit, time_s, image, markers.ids[clear][image.rows])
            for unit, image in zip(units, images, strict=True)
        ]

    def _sight(self, world: World, unit: int, time_s: float, image: TeamImage, ids: IntArray) -> Sight:
        """Make the detections of the markers `ids` that are whole in a unit's image."""
        centers, corners, whole_ids = image.centers_px, image.corners_px, ids
        headings, sides = headings_of_corners(centers, corners), sides_of_corners(corners)
        covariances = np.zeros((ids.size, 3, 3))
        if self.accuracy is not None:
            found = self.accuracy.found(sides, self.rng)
            ids, centers, corners = ids[found], centers[found], corners[found]
            covariances = self.accuracy.covariances(sides[found])
            error = np.sqrt(np.einsum("nii->ni", covariances)) * self.rng.standard_normal((ids.size, 3))
            shapes = self.accuracy.draw_shapes(sides[found], error[:, 2], self.rng)
            corners = centers[:, None] + (corners - centers[:, None]) @ shapes.swapaxes(1, 2)
            centers, corners = centers + error[:, :2], corners + error[:, None, :2]
            headings, sides = headings[found] + error[:, 2], sides_of_corners(corners)
        detections = Detections(
            unit_id=unit,
            time_s=time_s,
            image_size_px=np.array(world.cameras[unit].size_px),
            ids=ids,
            centers_px=centers,
            headings_rad=headings,
            sides_px=sides,
            corners_px=corners,
            covariances=covariances,
            qualities=np.full(ids.size, Quality.PHOTOMETRIC),
        )
        return Sight(detections, whole_ids, ids, 0, None)
