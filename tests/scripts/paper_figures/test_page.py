"""The page of the paper's tables and figures: each under its number, figures as PNG and SVG beside it."""

from pathlib import Path

from matplotlib.figure import Figure

from scripts.paper_figures import PaperFigure, PaperTable, exponent_figure, paper_html, steepness_figure
from scripts.paper_figures import write_paper_figures as write


def test_figures_and_page(tmp_path: Path) -> None:
    figures = [
        PaperFigure("gamma", "After Fig. 8", "γ < 4", steepness_figure()),
        PaperFigure("m", "After Fig. 9", "m", exponent_figure()),
    ]
    assert all(isinstance(each.figure, Figure) for each in figures)
    written = write(tmp_path, figures)
    assert [path.name for path in written] == ["gamma.png", "gamma.svg", "m.png", "m.svg"]
    assert all(path.stat().st_size > 1000 for path in written)
    rows = [("", "here", "Ren 2008"), ("tracking, mean", "0.10 mm", "0.29 mm")]
    page = paper_html(figures, [PaperTable("Table II", rows, ["People < machines."])])
    assert page.index("Table II") < page.index("After Fig. 8") < page.index("After Fig. 9")
    assert "<li>People &lt; machines.</li>" in page
    assert "γ &lt; 4" in page
    assert "<a href='gamma.svg'>" in page
    assert page.count("data:image/png;base64,") == 2
    assert "<td>tracking, mean</td><td>0.10 mm</td><td>0.29 mm</td>" in page
