"""Fills the ground planes, runs KiCad's design rule check, plots Gerbers: `python3 firmware/board/fabricate.py OUT`.

Needs the Python that KiCad 6 brings its module pcbnew for (Debian: `apt install kicad`, then /usr/bin/python3).
"""

import sys
from pathlib import Path

import pcbnew

LAYERS = (
    (pcbnew.F_Cu, "F_Cu"),
    (pcbnew.B_Cu, "B_Cu"),
    (pcbnew.F_Mask, "F_Mask"),
    (pcbnew.B_Mask, "B_Mask"),
    (pcbnew.F_Paste, "F_Paste"),
    (pcbnew.F_SilkS, "F_Silkscreen"),
    (pcbnew.Edge_Cuts, "Edge_Cuts"),
)


def main() -> int:
    """Status 1 where the check finds something."""
    out = Path(sys.argv[1]).resolve()
    path = out / "gof_board_driver.kicad_pcb"
    board = pcbnew.LoadBoard(str(path))
    pcbnew.ZONE_FILLER(board).Fill(board.Zones())
    board.Save(str(path))
    report = out / "drc.txt"
    pcbnew.WriteDRCReport(board, str(report), pcbnew.EDA_UNITS_MILLIMETRES, True)
    gerber = out / "gerber"
    gerber.mkdir(exist_ok=True)
    plots = pcbnew.PLOT_CONTROLLER(board)
    options = plots.GetPlotOptions()
    options.SetOutputDirectory(str(gerber))
    options.SetUseGerberProtelExtensions(False)
    options.SetSubtractMaskFromSilk(True)
    for layer, suffix in LAYERS:
        plots.SetLayer(layer)
        plots.OpenPlotfile(suffix, pcbnew.PLOT_FORMAT_GERBER, suffix)
        plots.PlotLayer()
    plots.ClosePlot()
    drill = pcbnew.EXCELLON_WRITER(board)
    drill.SetOptions(False, False, pcbnew.wxPoint(0, 0), False)
    drill.SetFormat(True)
    drill.CreateDrillandMapFilesSet(str(gerber), True, False)
    text = report.read_text()
    print(text)
    return 0 if "Found 0 DRC violations" in text and "Found 0 unconnected pads" in text else 1


if __name__ == "__main__":
    sys.exit(main())
