"""Square markers: dictionaries and codes, how well they can be measured, and printable sheets."""
