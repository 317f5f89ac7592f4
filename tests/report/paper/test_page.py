"""The page of the paper's figures: each under its number, as PNG and SVG beside it, and Table II."""

from pathlib import Path

from matplotlib.figure import Figure

from dvf_ig.report.paper import PaperFigure, exponent_figure, paper_html, steepness_figure
from dvf_ig.report.paper import write_paper_figures as write


def test_figures_and_page(tmp_path: Path) -> None:
    figures = [
        PaperFigure("gamma", "After Fig. 8", "γ < 4", steepness_figure()),
        PaperFigure("m", "After Fig. 9", "m", exponent_figure()),
    ]
    assert all(isinstance(each.figure, Figure) for each in figures)
    written = write(tmp_path, figures)
    assert [path.name for path in written] == ["gamma.png", "gamma.svg", "m.png", "m.svg"]
    assert all(path.stat().st_size > 1000 for path in written)
    page = paper_html(figures, [("tracking, mean", "0.10 mm", "0.29 mm")])
    assert page.index("After Fig. 8") < page.index("After Fig. 9") < page.index("After Table II")
    assert "γ &lt; 4" in page
    assert "<a href='gamma.svg'>" in page
    assert page.count("data:image/png;base64,") == 2
    assert "<td>tracking, mean</td><td>0.10 mm</td><td>0.29 mm</td>" in page
