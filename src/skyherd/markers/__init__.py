"""Square markers: dictionaries and codes, the Cramér–Rao bound, and printable sheets."""
