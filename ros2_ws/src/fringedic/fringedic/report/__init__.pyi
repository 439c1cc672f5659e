from .experiment import write_report as write_report
