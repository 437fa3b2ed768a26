import sys

from gof.cli import main

sys.exit(main())
