"""Packages that are called like a function."""

from inspect import Signature, signature
from types import ModuleType


class CallablePackage(ModuleType):
    """A package that is called as its function of its own name: `gof.evaluate()` is `gof.evaluate.evaluate()`."""

    def __call__(self, *args, **kwargs):
        return self.__wrapped__(*args, **kwargs)

    @property
    def __wrapped__(self):
        return getattr(self, self.__name__.rpartition(".")[2])

    @property
    def __signature__(self) -> Signature:
        return signature(self.__wrapped__)
