"""What the processes of a cluster are forked off imports this first: Ctrl-C is not for them.

At a terminal it comes to them too, but the command that started them closes them.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
