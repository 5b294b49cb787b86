"""`skyherd markers`: printable sheets of markers at true size."""

from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.choices import DICTIONARIES, PAPERS, complete_dictionary, complete_paper
from skyherd.cli.console import say
from skyherd.cli.options import BorderBits, ForceFile
from skyherd.errors import InputError


def markers(
    ids: Annotated[str, typer.Option(metavar="IDS", help="Ids and ranges of ids, such as 0-15,20.")],
    side: Annotated[
        str,
        typer.Option(metavar="LENGTH", help="Side of the black square, such as 0.12m, 12cm or 120mm."),
    ],
    out_file: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="PDF file to write, such as sheets.pdf.")
    ],
    paper: Annotated[
        str,
        typer.Option(metavar="NAME", help=f"Paper: {', '.join(PAPERS)}.", autocompletion=complete_paper),
    ] = "A4",
    dictionary: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Dictionary of the markers: {', '.join(DICTIONARIES)}. OpenCV's names, such as "
            "DICT_4X4_50, are accepted, too.",
            autocompletion=complete_dictionary,
        ),
    ] = "4X4_50",
    border_bits: BorderBits = 1,
    force: ForceFile = False,
) -> int:
    """Make printable sheets of markers at true size.

    Each marker has its quiet zone, id, forward arrow and cut marks. Each sheet has a ruler to check the
    scale.
    """
    from skyherd.files.output_file import OutputFile
    from skyherd.markers.dictionary import load_dictionary, with_border
    from skyherd.markers.sheet_layout import PAPERS_MM, parse_ids, parse_length_mm
    from skyherd.markers.sheets import write_sheets

    dictionary = with_border(dictionary, border_bits)
    load_dictionary(dictionary)
    if out_file.suffix.lower() != ".pdf":
        raise InputError("--out", f"{str(out_file)!r} is not a PDF", "a name that ends in .pdf")
    output = OutputFile(out_file, "markers", force=force)
    output.check()
    wanted = parse_ids(ids, dictionary)
    known = {name.lower(): name for name in PAPERS_MM}
    side_mm, sheet = parse_length_mm(side, "--side"), known.get(paper.lower(), paper)
    with output:
        layout = write_sheets(out_file, wanted, side_mm, dictionary=dictionary, paper=sheet)
    pages = -(-len(wanted) // layout.per_page)
    say(
        f"{out_file}: {len(wanted)} markers of {layout.side_mm:g} mm, cards of {layout.card_mm:.4g} mm, on "
        f"{pages} page(s); print at 100 % and measure the ruler"
    )
    return 0
