"""`skyherd bench photographs`: what detectors find on photographs, where nobody knows the truth.

`sightings.py` runs detectors that can be told of a set's markers, `confirmation.py` says which markers count
as there, `measurement.py` goes through the sets and counts, `result.py` keeps the rows, and
`contact_sheet.py`, `tables.py` and `page.py` show them.
"""
