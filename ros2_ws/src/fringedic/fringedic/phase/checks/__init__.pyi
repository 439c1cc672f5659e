from .stack import check_stack as check_stack
