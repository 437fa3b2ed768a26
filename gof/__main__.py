import sys

from gof.commands.cli import main

sys.exit(main())
