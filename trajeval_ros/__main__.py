"""`python -m trajeval_ros` is `trajeval`."""

import sys

from trajeval_ros.cli.app import main

sys.exit(main())
