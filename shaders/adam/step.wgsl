// One parameter an invocation.
alias Value = f32;
#import shared/adam_step
