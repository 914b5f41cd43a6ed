"""The config of a run: what it may say, how it is read and how it is refused."""

from torchid.config.explain import InvalidConfig as InvalidConfig
from torchid.config.groups import GroupQuestion as GroupQuestion
from torchid.config.loading import dump_config as dump_config
from torchid.config.loading import load_config as load_config
from torchid.config.loading import load_evaluation as load_evaluation
from torchid.config.sections import Config as Config
from torchid.config.study import Study as Study
