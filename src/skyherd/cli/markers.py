"""`skyherd markers`: printable sheets of markers at true size."""

from pathlib import Path
from typing import Annotated

import typer

from skyherd.cli.choices import PAPERS, complete_dictionary, complete_paper
from skyherd.cli.console import say
from skyherd.errors import InputError


def markers(
    ids: Annotated[str, typer.Option(help="Ids and ranges, such as 0-15,20.")],
    side: Annotated[str, typer.Option(help="Side of the black square, such as 0.12m, 12cm or 120mm.")],
    out_file: Annotated[Path, typer.Option("--out", help="PDF to write.")],
    paper: Annotated[
        str, typer.Option(help=f"One of {', '.join(PAPERS)}.", autocompletion=complete_paper)
    ] = "A4",
    dictionary: Annotated[
        str,
        typer.Option(help="Marker dictionary, such as APRILTAG_36h11.", autocompletion=complete_dictionary),
    ] = "4X4_50",
    border_bits: Annotated[
        int, typer.Option("--border-bits", min=1, max=3, help="Cells of the markers' black border.")
    ] = 1,
    force: Annotated[
        bool, typer.Option("--force", help="Write a file of sheets that is there anew.")
    ] = False,
) -> int:
    """Print markers at true size, with quiet zone, id, forward arrow, cut marks and a ruler."""
    from skyherd.files.output_file import OutputFile
    from skyherd.markers.dictionary import load_dictionary, with_border
    from skyherd.markers.sheet_layout import PAPERS_MM, parse_ids, parse_length_mm
    from skyherd.markers.sheets import write_sheets

    dictionary = with_border(dictionary, border_bits)
    load_dictionary(dictionary)
    if out_file.suffix.lower() != ".pdf":
        raise InputError("--out", f"{str(out_file)!r} is no PDF", "a name that ends in .pdf")
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
