"""Many recordings processed as one campaign: plan, units of work, one store, a catalogue; resumable at any time.

`settings` reads ``campaign.yaml``, `plan` makes one unit of work of each recording from the summaries alone, `unit`
processes one, `store` contains results and receipts, `engines` distribute the units, `opening` returns the results as a
tree of datasets with a catalogue. A unit is complete when its receipt exists, which is written last.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
