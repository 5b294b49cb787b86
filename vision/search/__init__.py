"""From an image to candidates: dark regions, quadrilaterals, decoded ids."""
