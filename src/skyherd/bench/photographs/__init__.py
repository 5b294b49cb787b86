"""`skyherd bench photographs`: recall of detectors on photographs without ground truth.

`sightings.py` runs detectors with a set's marker options. `confirmation.py` decides which markers count.
`measurement.py` processes the sets and counts, and `result.py` keeps the rows. `contact_sheet.py`,
`tables.py` and `page.py` show them.
"""
