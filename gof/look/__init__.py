"""Everything that people look at: report, shared page, viewer, films, figures, boards. Knows HTML and charts."""
